"use strict";
// Draws a run from the data of page/run.py. A step t is an index into the steps that are stored.
(async () => {
const $ = (id) => document.getElementById(id);
const about = JSON.parse($("about").textContent);
const TYPES = { float32: Float32Array, uint16: Uint16Array, uint8: Uint8Array };
const packed = Uint8Array.from(atob(about.data), (c) => c.charCodeAt(0));
const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
const buffer = await new Response(unpacked).arrayBuffer();
const data = {}; // by name: values, and how many there are of each step
for (const [name, type, shape, offset] of about.arrays) {
  const size = shape.reduce((a, b) => a * b, 1);
  data[name] = new TYPES[type](buffer, offset, size);
  data[name].each = size / shape[0];
}
const row = (name, t) => data[name].subarray(t * data[name].each, (t + 1) * data[name].each);
const { steps, unit, end, rows, taus } = about;
const N = rows.length, last = steps.length - 1;
const time = (t) => steps[t] * about.period; // s, or steps where the period is unknown
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const pictures = about.pictures.map((uri) => Object.assign(new Image(), { src: uri }));
await Promise.all(pictures.map((image) => image.decode()));
let t = 0, playing = false;

const LEFT = 34, RIGHT = 14; // beside the plot area
// A panel: the plot area (x, y, w, h) of a figure's canvas, in CSS pixels, and two axes.
function panel(id, { x: [x0, x1], y: [y0, y1], label = "", names = null, equal = false }) {
  const canvas = $(id).querySelector("canvas"), scale = devicePixelRatio;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * scale; canvas.height = height * scale;
  const c = canvas.getContext("2d");
  c.scale(scale, scale);
  c.font = "11px system-ui, sans-serif"; c.lineWidth = 1;
  const area = { x: LEFT, y: 4, w: width - LEFT - RIGHT, h: height - 36 };
  if (equal) { // the same scale on both axes
    const k = Math.min(area.w / (x1 - x0), area.h / (y1 - y0));
    area.x += (area.w - k * (x1 - x0)) / 2; area.w = k * (x1 - x0); area.h = k * (y1 - y0);
  }
  const X = (x) => area.x + (x - x0) / (x1 - x0) * area.w;
  const Y = (y) => area.y + area.h - (y - y0) / (y1 - y0) * area.h;
  c.strokeStyle = css("--line"); c.strokeRect(area.x, area.y, area.w, area.h);
  c.fillStyle = css("--soft"); c.textAlign = "center";
  for (const x of ticks(x0, x1, area.w / 60)) c.fillText(x, X(x), area.y + area.h + 13);
  c.fillText(label, area.x + area.w / 2, area.y + area.h + 27);
  c.textAlign = "right";
  for (const y of ticks(y0, y1, area.h / 25)) if (!names || Number.isInteger(y)) {
    c.fillText(names ? names[y] : y, area.x - 5, Y(y) + 4);
  }
  return { c, X, Y, area };
}
function ticks(from, to, most) {
  const rough = (to - from) / Math.max(most, 1), power = 10 ** Math.floor(Math.log10(rough));
  const apart = power * [1, 2, 5, 10].find((k) => k * power >= rough), found = [];
  for (let k = Math.ceil(from / apart); k * apart <= to; k++) found.push(+(k * apart).toPrecision(9));
  return found;
}
function line(c, points, style, width = 1, dash = []) {
  c.strokeStyle = style; c.lineWidth = width; c.setLineDash(dash); c.beginPath();
  for (const [x, y] of points) c.lineTo(x, y);
  c.stroke(); c.setLineDash([]);
}
// An image of values 0 … 255, given by column and row: ink on paper, as opaque as they are large.
function image(columns, n, value) {
  const canvas = new OffscreenCanvas(columns, n), c = canvas.getContext("2d");
  const pixels = c.createImageData(columns, n), ink = css("--ink") === "#111" ? 17 : 240;
  for (let k = 0; k < n; k++) for (let i = 0; i < columns; i++) {
    const at = 4 * ((n - 1 - k) * columns + i); // the first row is the lowest
    pixels.data.fill(ink, at, at + 3); pixels.data[at + 3] = value(i, k);
  }
  c.putImageData(pixels, 0, 0);
  return canvas;
}
const paste = (c, picture, { x, y, w, h }) => {
  c.imageSmoothingEnabled = false; c.drawImage(picture, x, y, w, h);
};
const RECORDS = { y: [-0.5, N - 0.5], names: rows };

function drawWorld() {
  if (about.pictures.length) {
    const shown = pictures[about.shown[t]], { c, area } = panel("world", { x: [0, 1], y: [0, 1] });
    const k = Math.min(area.w / shown.width, area.h / shown.height);
    c.clearRect(0, 0, 1e4, 1e4); c.drawImage(shown, area.x, area.y, k * shown.width, k * shown.height);
  } else if (about.plane) drawPlane(about.plane);
}
function drawPlane(p) {
  const [x0, x1, y0, y1] = p.area.map((v) => 100 * v);
  const { c, X, Y } = panel("world", { x: [x0, x1], y: [y0, y1], label: "ahead, cm", equal: true });
  const [rx, ry, heading] = row("robot", t), [qx, qy, angle] = row("cube", t);
  const at = (x, y, a, points) => points.map(([u, v]) => [
    X(100 * (x + u * Math.cos(a) - v * Math.sin(a))), Y(100 * (y + u * Math.sin(a) + v * Math.cos(a)))]);
  const shape = (points, fill, width = 1) => {
    c.fillStyle = fill; c.beginPath();
    for (const [x, y] of points) c.lineTo(x, y);
    c.closePath(); c.fill(); c.strokeStyle = css("--ink"); c.lineWidth = width; c.stroke();
  };
  c.save(); c.beginPath(); c.rect(X(x0), Y(y1), X(x1) - X(x0), Y(y0) - Y(y1)); c.clip();
  const half = p.view / 2, far = (side) => [0.6 * Math.cos(half), side * 0.6 * Math.sin(half)];
  line(c, at(rx, ry, heading, [far(-1), [0, 0], far(1)]), css("--line"));
  const trail = [];
  for (let k = 0; k <= t; k++) trail.push([X(100 * row("robot", k)[0]), Y(100 * row("robot", k)[1])]);
  line(c, trail, css("--trail"), 1.5);
  const beams = row("beams", t);
  for (let k = 0; k < beams.length; k += 4) line(c, at(0, 0, 0, [beams.subarray(k, k + 2),
    beams.subarray(k + 2, k + 4)]), css("--beam"));
  const s = p.side / 2, g = p.gripper / 2, held = data.held[t];
  shape(at(qx, qy, angle, [[-s, -s], [s, -s], [s, s], [-s, s]]), css("--cube"), held ? 3 : 1);
  const hull = Array.from({ length: 48 }, (_, k) => 2 * Math.PI * k / 48);
  shape(at(rx, ry, 0, hull.map((a) => [p.hull * Math.cos(a), p.hull * Math.sin(a)])), css("--hull"));
  line(c, at(rx, ry, heading, [[0, 0], [p.hull, 0]]), css("--ink"));
  c.globalAlpha = 1 - 0.7 * data.raised[t];
  shape(at(rx, ry, heading, [[p.hull, -g], [p.reach, -g], [p.reach, g], [p.hull, g]]), css("--grip"));
  c.restore();
}
function drawNow() {
  const belief = row("belief", t), columns = belief.length / N;
  const { c, X, Y, area } = panel("now", { x: [0, taus], ...RECORDS, label: `moment τ, ${unit}` });
  paste(c, image(columns, N, (i, k) => belief[k * columns + i]), area);
  about.ends.forEach((x, k) => line(c, [[X(x), Y(k - 0.5)], [X(x), Y(k + 0.5)]], css("--soft")));
}
let stripes = null; // p(I) of all steps
function drawPast() {
  const { c, X, Y, area } = panel("past", { x: [0, end], ...RECORDS, label: `time, ${unit}` });
  stripes ??= image(steps.length, N, (i, k) => data.share[i * N + k] / 257);
  c.save(); c.beginPath(); c.rect(0, 0, X(time(t)), 1e4); c.clip();
  paste(c, stripes, { ...area, x: X(0), w: X(time(last)) - X(0) });
  for (const jump of about.jumps) {
    const x = X(time(jump)), y = area.y;
    c.fillStyle = css("--beam"); c.beginPath();
    c.moveTo(x - 4, y); c.lineTo(x + 4, y); c.lineTo(x, y + 7); c.fill();
  }
  c.restore();
}
const DASHES = [[], [6, 3], [2, 2], [8, 2, 2, 2]];
const style = (k, n) => `hsl(${220 + 100 * k / n} 55% calc(var(--low) + (var(--high) - var(--low)) * ${
  k / Math.max(n - 1, 1)}))`;
function drawCurves(id) {
  const { names, low, span } = about[id], n = names.length;
  const { c, X, Y } = panel(id, { x: [0, end], y: [about[id].least, 1.05], label: `time, ${unit}` });
  const colours = [...$(id).querySelectorAll("i")].map((e) => getComputedStyle(e).borderTopColor);
  for (let k = 0; k < n; k++) {
    const points = [];
    for (let s = 0; s <= t; s++) points.push([X(time(s)), Y((row(id, s)[k] - low[k]) / span[k])]);
    line(c, points, colours[k], 1.4, DASHES[k % 4]);
  }
}
function show(step) {
  t = Math.max(0, Math.min(last, step));
  $("scrubber").value = t;
  $("play").textContent = playing ? "Pause" : "Play";
  $("clock").textContent = unit === "s" ? `${time(t).toFixed(1)} s` : `step ${time(t)}`;
  const shares = row("share", t), k = shares.indexOf(Math.max(...shares));
  $("reading").textContent = `${about.whose} record ${rows[k]} (${Math.round(shares[k] / 655.35)} %) at `
    + `τ = ${data.tau[t].toFixed(unit === "s" ? 1 : 0)} ${unit}` + (t === last ? `. End: ${about.ending}` : "");
  drawWorld(); drawNow(); drawPast(); drawCurves("sensors"); drawCurves("commands");
}

// Captions and legends
const caption = (id, text) => { $(id).querySelector("figcaption").textContent = text; };
caption("now", "belief p(I, τ) now (fourth root), by record I; bars: the records' ends");
caption("past", "p(I) so far, by record I; marks: another record is twice as probable as the one before");
if (about.plane) caption("world", "the plane from above; to the left, cm");
for (const id of ["sensors", "commands"]) {
  const { names, scale } = about[id], into = $(id).querySelector("figcaption");
  into.textContent = `${id}, ${scale}:`;
  names.forEach((name, k) => {
    const entry = document.createElement("span"), mark = document.createElement("i");
    mark.style.borderTopStyle = ["solid", "dashed", "dotted", "dashed"][k % 4];
    mark.style.borderTopColor = style(k, names.length);
    entry.append(mark, name);
    into.append(" ", entry);
  });
}
document.querySelector("main").classList.toggle("blind", !about.plane && !pictures.length);

// Controls
const speeds = [...$("speed").options].map((option) => +option.text);
const setSpeed = (k) => { $("speed").selectedIndex = Math.max(0, Math.min(speeds.length - 1, k)); };
setSpeed(Math.max(0, speeds.findIndex((s) => s >= about.speed)));
$("scrubber").max = last;
$("scrubber").oninput = () => { playing = false; show(+$("scrubber").value); };
let started; // the wall clock, ms, at which step 0 would have been shown
const rate = () => speeds[$("speed").selectedIndex] * (unit === "s" ? 1 : 10) / 1000;
const begin = () => { started = performance.now() - time(t) / rate(); };
function play(on) {
  playing = on;
  if (on && t === last) t = 0;
  begin(); show(t);
  if (on) requestAnimationFrame(tick);
}
function tick() {
  if (!playing) return;
  const now = (performance.now() - started) * rate();
  let next = t;
  while (next < last && time(next + 1) <= now) next++;
  if (next !== t) show(next);
  if (t === last) play(false); else requestAnimationFrame(tick);
}
$("play").onclick = () => play(!playing);
$("speed").onchange = begin;
const KEYS = {
  " ": () => play(!playing), Home: () => show(0), End: () => show(last),
  "+": () => { setSpeed($("speed").selectedIndex + 1); begin(); },
  "-": () => { setSpeed($("speed").selectedIndex - 1); begin(); },
};
addEventListener("keydown", (event) => {
  const way = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (event.ctrlKey || event.metaKey || event.altKey || !(way || KEYS[event.key])) return;
  event.preventDefault(); document.activeElement.blur();
  if (way || event.key === "Home" || event.key === "End") playing = false;
  if (way) show(t + way * (event.shiftKey ? 10 : 1)); else KEYS[event.key]();
});
for (const id of ["past", "sensors", "commands"]) $(id).querySelector("canvas").onclick = (event) => {
  const wanted = (event.offsetX - LEFT) / (event.target.clientWidth - LEFT - RIGHT) * end;
  playing = false; show(steps.findLastIndex((_, k) => time(k) <= wanted));
};
const again = () => { stripes = null; show(t); };
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
new ResizeObserver(again).observe(document.body);
show(0);
})();
