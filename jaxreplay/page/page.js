"use strict";
// Draws a run from the data of page/run.py: from the page itself, or live from explore's server.
const $ = (id) => document.getElementById(id);
const make = (tag, values = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), values);
  element.append(...children);
  return element;
};
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const about = JSON.parse($("about").textContent);
let run, frames = [], ending = null; // what is shown: its description, its steps, how it ended
let t = 0, playing = false, growing = false, pictures = [];
const last = () => frames.length - 1;
const time = (k) => frames[k].step[0] * run.period; // s, or steps where the period is unknown

async function unpack({ arrays, packed }) { // an object of arrays for each step
  const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(unpacked).arrayBuffer();
  const types = { float32: Float32Array, uint16: Uint16Array, uint8: Uint8Array };
  const steps = Array.from({ length: arrays[0][2][0] }, () => ({}));
  for (const [name, type, shape, offset] of arrays) {
    const each = shape.reduce((a, b) => a * b, 1) / shape[0];
    const all = new types[type](buffer, offset, each * shape[0]);
    steps.forEach((step, k) => { step[name] = all.subarray(k * each, (k + 1) * each); });
  }
  return steps;
}

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
const records = () => ({ y: [-0.5, run.rows.length - 0.5], names: run.rows });

let dragged = null, place = null; // the cube while it is dragged, and where a pixel is
function drawWorld() {
  if (!frames.length) return;
  if (pictures.length) {
    const shown = pictures[frames[t].shown[0]], { c, area } = panel("world", { x: [0, 1], y: [0, 1] });
    const k = Math.min(area.w / shown.width, area.h / shown.height);
    c.clearRect(0, 0, 1e4, 1e4); c.drawImage(shown, area.x, area.y, k * shown.width, k * shown.height);
  } else if (run.plane) drawPlane(run.plane);
}
function drawPlane(p) {
  const [x0, x1, y0, y1] = p.area.map((v) => 100 * v);
  const { c, X, Y, area } = panel("world", { x: [x0, x1], y: [y0, y1], label: "ahead, cm", equal: true });
  place = (x, y) => [ // of a point of the canvas, m
    (x0 + (x - area.x) / area.w * (x1 - x0)) / 100, (y1 - (y - area.y) / area.h * (y1 - y0)) / 100];
  const [rx, ry, heading] = frames[t].robot, [qx, qy, angle] = dragged ?? frames[t].cube;
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
  for (const { robot } of frames.slice(0, t + 1)) trail.push([X(100 * robot[0]), Y(100 * robot[1])]);
  line(c, trail, css("--trail"), 1.5);
  const { beams } = frames[t];
  for (let k = 0; k < beams.length; k += 4) line(c, at(0, 0, 0, [beams.subarray(k, k + 2),
    beams.subarray(k + 2, k + 4)]), css("--beam"));
  const s = p.side / 2, g = p.gripper / 2, held = frames[t].held[0];
  shape(at(qx, qy, angle, [[-s, -s], [s, -s], [s, s], [-s, s]]), css("--cube"), held ? 3 : 1);
  const hull = Array.from({ length: 48 }, (_, k) => 2 * Math.PI * k / 48);
  shape(at(rx, ry, 0, hull.map((a) => [p.hull * Math.cos(a), p.hull * Math.sin(a)])), css("--hull"));
  line(c, at(rx, ry, heading, [[0, 0], [p.hull, 0]]), css("--ink"));
  c.globalAlpha = 1 - 0.7 * frames[t].raised[0];
  shape(at(rx, ry, heading, [[p.hull, -g], [p.reach, -g], [p.reach, g], [p.hull, g]]), css("--grip"));
  c.restore();
}
function drawNow() {
  const { belief } = frames[t], N = run.rows.length, columns = belief.length / N;
  const label = `moment τ, ${run.unit}`;
  const { c, X, Y, area } = panel("now", { x: [0, run.taus], ...records(), label });
  c.imageSmoothingEnabled = false;
  c.drawImage(image(columns, N, (i, k) => belief[k * columns + i]), area.x, area.y, area.w, area.h);
  run.ends.forEach((x, k) => line(c, [[X(x), Y(k - 0.5)], [X(x), Y(k + 0.5)]], css("--soft")));
}
let stripes, painted; // p(I) of the steps so far, a column each
function drawPast() {
  const { c, X, Y, area } = panel("past", { x: [0, end()], ...records(), label: `time, ${run.unit}` });
  const N = run.rows.length;
  if (last() >= stripes.width) [stripes, painted] = [new OffscreenCanvas(2 * last(), N), 0];
  const paper = stripes.getContext("2d");
  if (painted === 0) paper.clearRect(0, 0, stripes.width, N);
  if (painted <= last()) {
    const from = painted;
    paper.drawImage(image(last() + 1 - from, N, (i, k) => frames[from + i].share[k] / 257), from, 0);
    painted = last() + 1;
  }
  const width = X(time(t)) - X(0);
  c.imageSmoothingEnabled = false;
  c.drawImage(stripes, 0, 0, t + 1, N, area.x, area.y, width, area.h);
  c.fillStyle = css("--beam");
  for (let k = 0; k <= t; k++) if (frames[k].jump[0]) {
    const x = X(time(k)), y = area.y;
    c.beginPath(); c.moveTo(x - 4, y); c.lineTo(x + 4, y); c.lineTo(x, y + 7); c.fill();
  }
}
const end = () => Math.max(run.end, frames.length ? time(last()) : 0); // of the axes of time
const DASHES = [[], [6, 3], [2, 2], [8, 2, 2, 2]];
const colour = (k, n) => `hsl(${220 + 100 * k / n} 55% calc(var(--low) + (var(--high) - var(--low)) * ${
  k / Math.max(n - 1, 1)}))`;
function drawCurves(id) {
  const { names, low, span, least } = run[id];
  const { c, X, Y } = panel(id, { x: [0, end()], y: [least, 1.05], label: `time, ${run.unit}` });
  const colours = [...$(id).querySelectorAll("i")].map((e) => getComputedStyle(e).borderTopColor);
  names.forEach((_, k) => {
    const points = [];
    for (let s = 0; s <= t; s++) points.push([X(time(s)), Y((frames[s][id][k] - low[k]) / span[k])]);
    line(c, points, colours[k], 1.4, DASHES[k % 4]);
  });
}
function show(step) {
  if (!frames.length) return;
  t = Math.max(0, Math.min(last(), step));
  const { share, followed, tau } = frames[t], digits = run.unit === "s" ? 1 : 0;
  $("scrubber").max = last(); $("scrubber").value = t;
  $("play").textContent = playing ? "Pause" : "Play";
  $("clock").textContent = digits ? `${time(t).toFixed(1)} s` : `step ${time(t)}`;
  let reading = "";
  if (share) {
    reading = `${run.whose} record ${followed[0]} (${Math.round(100 * followed[1])} %) at `
      + `τ = ${tau[0].toFixed(digits)} ${run.unit}`;
  }
  if (t === last() && ending !== null) reading += `. End: ${ending}`;
  $("reading").textContent = reading;
  drawWorld();
  if (share) { drawNow(); drawPast(); }
  drawCurves("sensors"); drawCurves("commands");
}

// Prepare to show another run, whose steps follow.
async function prepare(described) {
  pictures = described.pictures.map((uri) => make("img", { src: uri }));
  await Promise.all(pictures.map((image) => image.decode()));
  [run, frames, ending, t, painted] = [described, [], null, 0, 0];
  stripes = new OffscreenCanvas(2000, Math.max(run.rows.length, 1));
  document.querySelector("header b").textContent = run.title;
  document.querySelector("header span").textContent = run.place;
  const caption = (id, text) => { $(id).querySelector("figcaption").textContent = text; };
  const some = run.records > run.rows.length ? ` (${run.rows.length} of ${run.records})` : "";
  caption("now", `belief p(I, τ) now (fourth root), by record I${some}; bars: the records' ends`);
  caption("past", "p(I) so far, by record I; marks: another record is twice as probable as the one before");
  caption("world", run.plane ? "the plane from above; to the left, cm" : "");
  for (const id of ["sensors", "commands"]) {
    const { names, scale } = run[id], into = $(id).querySelector("figcaption");
    into.textContent = `${id}, ${scale}:`;
    names.forEach((name, k) => {
      const mark = make("i");
      mark.style.borderTopStyle = ["solid", "dashed", "dotted", "dashed"][k % 4];
      mark.style.borderTopColor = colour(k, names.length);
      into.append(" ", make("span", {}, mark, name));
    });
  }
  arrange();
}
function arrange() { // which figures there are
  const { classList } = document.querySelector("main");
  classList.toggle("blind", !run.plane && !pictures.length);
  classList.toggle("driven", !run.rows.length);
}

// Controls
const speeds = [...$("speed").options].map((option) => +option.text);
const setSpeed = (k) => { $("speed").selectedIndex = Math.max(0, Math.min(speeds.length - 1, k)); };
const rate = () => speeds[$("speed").selectedIndex] * (run.unit === "s" ? 1 : 10) / 1000;
let at, before; // the moment that is played, and the wall clock then, ms
function play(on) {
  playing = on;
  if (on && t === last() && !growing) t = 0;
  show(t);
  if (on && frames.length) {
    [at, before] = [time(t), performance.now()];
    requestAnimationFrame(tick);
  }
}
function tick(now) {
  if (!playing) return;
  at = Math.min(at + Math.max(0, now - before) * rate(), time(last()));
  before = now;
  let next = t;
  while (next < last() && time(next + 1) <= at) next++;
  if (next !== t) show(next);
  if (t === last() && !growing) play(false); else requestAnimationFrame(tick);
}
function seek(step) { playing = false; show(step); }
$("scrubber").oninput = () => seek(+$("scrubber").value);
$("play").onclick = () => play(!playing);
const KEYS = {
  " ": () => play(!playing), Home: () => seek(0), End: () => seek(last()),
  "+": () => setSpeed($("speed").selectedIndex + 1),
  "-": () => setSpeed($("speed").selectedIndex - 1),
};
let mode = null; // of explore
addEventListener("keydown", (event) => {
  const takers = `aside input, select${event.key === " " ? ", button" : ""}`; // of this key
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.(takers)) return;
  const way = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (mode === "Drive" || !frames.length || !(way || KEYS[event.key])) return;
  event.preventDefault(); document.activeElement.blur();
  if (way) seek(t + way * (event.shiftKey ? 10 : 1)); else KEYS[event.key]();
});
for (const id of ["past", "sensors", "commands"]) $(id).querySelector("canvas").onclick = (event) => {
  if (!frames.length) return;
  const wanted = (event.offsetX - LEFT) / (event.target.clientWidth - LEFT - RIGHT) * end();
  seek(frames.findLastIndex((_, k) => time(k) <= wanted));
};
const again = () => { painted = 0; show(t); };
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
new ResizeObserver(again).observe(document.body);

// Explore: the server tells what there is, and sends runs; the page asks.
let hello = null, values = {}, socket = null, later = 0, driving = false, unsaved = false;
const aside = document.querySelector("aside"), tabs = [...document.querySelectorAll("nav button")];
const ask = (what, more = {}) => socket.send(JSON.stringify({ do: what, ...more }));
const said = make("p", { id: "said" });
const say = (text) => { said.textContent = text; };
function connect() {
  let done = Promise.resolve();
  socket = new WebSocket(location.href.replace(/^http/, "ws") + "live");
  socket.onmessage = ({ data }) => {
    done = done.then(() => receive(JSON.parse(data))).catch((error) => say(`${error}`));
  };
  socket.onclose = () => say("The server has ended: start jaxreplay explore again.");
}
async function receive(message) {
  if (message.kind === "hello") {
    [hello, values] = [message, message.values];
    document.querySelector("nav").hidden = false;
    for (const tab of tabs) tab.hidden = (tab.textContent === "Study" && !hello.study) ||
      (tab.textContent === "Drive" && !hello.keys);
    enter(hello.study ? "Study" : "Ask");
  } else if (message.kind === "values") {
    values = message.values;
    if (mode === "Ask") enter(mode);
  } else if (message.kind === "run") {
    [playing, growing] = [false, true];
    say(""); await prepare(message.run);
  } else if (message.kind === "steps") {
    const uris = message.pictures.map((uri) => make("img", { src: uri }));
    const [steps] = await Promise.all([unpack(message.data), ...uris.map((image) => image.decode())]);
    pictures.push(...uris); frames.push(...steps);
    arrange();
    if (!run.rows.length) show(last()); // driven: there is nothing to wait for
    else if (frames.length === steps.length) play(true);
    else $("scrubber").max = last();
  } else if (message.kind === "end") {
    [growing, ending, driving] = [false, message.ending, false];
    unsaved ||= message.kept > 0;
    say(message.note); show(t);
  } else if (message.kind === "saved") {
    unsaved = false; say(message.text);
  } else if (message.kind === "say") say(message.text);
}
function enter(name) {
  clearTimeout(later);
  if (driving) ask("stop");
  mode = name;
  for (const tab of tabs) tab.classList.toggle("chosen", tab.textContent === name);
  aside.replaceChildren(...{ Study: studyView, Ask: askView, Drive: driveView }[name](), said);
  say("");
  if (name === "Ask" && !run?.rows.length) ask("ask", { values });
}
for (const tab of tabs) tab.onclick = () => { if (tab.textContent !== mode) enter(tab.textContent); };
addEventListener("beforeunload", (event) => { if (unsaved) event.preventDefault(); });

function studyView() {
  const { rows, columns, cells, meanings } = hello.study, chosen = make("div");
  const open = ({ text, first, outcomes }, title) => chosen.replaceChildren(
    make("p", {}, make("b", {}, title)), make("p", {}, text),
    make("div", { className: "runs" }, ...outcomes.map((code, k) => make("button", {
      className: code, textContent: code || "–", title: `run ${first + k}`, onclick: () => ask("play", { run: first + k }),
    }))));
  const shade = (cell, title) => {
    const button = make("button", { title: `${title}: ${cell.text}`, onclick: () => open(cell, title) });
    if (cell.success === null) return button;
    button.textContent = Math.round(100 * cell.success);
    button.style.background = `color-mix(in srgb, var(--ink) ${85 * cell.success}%, var(--back))`;
    button.style.color = cell.success > 0.5 ? "var(--back)" : "var(--ink)";
    return button;
  };
  const heads = columns.map((text) => make("th", {}, make("span", {}, text)));
  const table = make("table", {}, make("tr", {}, make("th"), ...heads), ...rows.map((row, i) =>
    make("tr", {}, make("th", {}, row), ...cells[i].map((cell, j) =>
      make("td", {}, shade(cell, [row, columns[j]].filter(Boolean).join(", ")))))));
  const legend = Object.entries(meanings).map(([code, text]) => `${code}: ${text}`).join(" · ");
  return [make("p", {}, `${hello.folder}: success, %; click a cell, then a run`),
    make("div", { className: "table" }, table), chosen, make("p", { className: "keys" }, legend)];
}
function askView() {
  const again = () => { clearTimeout(later); later = setTimeout(() => ask("ask", { values }), 200); };
  const fields = hello.controls.map(({ name, label, range, log, choices }) => {
    const shown = make("output");
    let input;
    if (choices) {
      input = make("select", {}, ...choices.map((value) => make("option", {}, `${value}`)));
      input.selectedIndex = choices.indexOf(values[name]);
      input.onchange = () => { values[name] = choices[input.selectedIndex]; again(); };
    } else {
      const [min, max, step] = range;
      input = make("input", { type: "range", min, max, step });
      input.value = log ? Math.log10(Math.max(values[name], 10 ** min)) : values[name];
      const tell = () => {
        const value = +(+values[name]).toPrecision(2);
        shown.textContent = value && value < 0.001 ? value.toExponential() : value;
      };
      input.oninput = () => { values[name] = log ? 10 ** input.value : +input.value; tell(); again(); };
      tell();
    }
    input.name = name;
    return make("label", {}, label, input, shown);
  });
  const number = make("input", { type: "number", min: 0, value: values.repeat, name: "repeat" });
  number.onchange = () => { values.repeat = Math.max(0, Math.round(number.value)); again(); };
  const hint = values.cube ? "Drag the cube to put it elsewhere. " : "";
  return [...fields, make("label", {}, "repeat: other noise", number, make("output")),
    make("p", { className: "keys" }, `${hint}A change starts the run anew.`)];
}
function driveView() {
  const name = make("input", { type: "text", placeholder: "name", name: "name" });
  const order = (what) => () => ask("order", { order: what });
  return [make("p", {}, "Demonstrate how to fetch the cube; what you do is what is replayed."),
    make("p", { className: "keys" }, hello.keys),
    make("p", {}, make("button", { onclick: () => { document.activeElement.blur(); driving = true; ask("drive"); } }, "Start"),
      " ", make("button", { onclick: order("keep") }, "Keep"), " ", make("button", { onclick: order("discard") }, "Discard")),
    make("p", {}, name, " ", make("button", { onclick: () => ask("save", { name: name.value }) }, "Save all kept"))];
}
const down = new Set();
for (const kind of ["keydown", "keyup"]) addEventListener(kind, (event) => {
  if (mode !== "Drive") return;
  const typing = event.target.type === "text", meant = hello.drive.includes(event.key.toLowerCase());
  if (kind === "keydown" && (typing || event.ctrlKey || event.metaKey || event.altKey || !meant)) return;
  if (!typing && meant) event.preventDefault();
  if (event.repeat) return;
  if (kind === "keydown") down.add(event.key); else for (const key of [...down]) {
    if (key.toLowerCase() === event.key.toLowerCase()) down.delete(key); // shift may have changed
  }
  ask("keys", { keys: [...down], pressed: kind === "keydown" ? [event.key] : [] });
});
addEventListener("blur", () => { down.clear(); if (mode === "Drive") ask("keys", { keys: [], pressed: [] }); });
const world = $("world").querySelector("canvas");
world.onpointerdown = (event) => {
  if (mode !== "Ask" || !frames.length || !run.plane) return;
  const [x, y] = place(event.offsetX, event.offsetY), [cx, cy] = frames[t].cube;
  if (Math.hypot(x - cx, y - cy) > run.plane.side) return;
  seek(0); world.setPointerCapture(event.pointerId);
  world.onpointermove = (moved) => {
    const within = (v, [low, high]) => Math.max(low, Math.min(high, v));
    const [u, v] = place(moved.offsetX, moved.offsetY);
    dragged = [within(u, hello.cubes[0]), within(v, hello.cubes[1]), 0];
    drawWorld();
  };
  world.onpointerup = world.onpointercancel = ({ type }) => {
    world.onpointermove = world.onpointerup = world.onpointercancel = null;
    if (dragged && type === "pointerup") { values.cube = dragged.slice(0, 2); ask("ask", { values }); }
    dragged = null;
    show(t);
  };
};

if (!about.run) {
  aside.hidden = false;
  document.body.classList.add("explore");
  aside.append(said); say("starting …"); connect();
} else (async () => {
  setSpeed(speeds.filter((s) => s < about.speed).length);
  const steps = await unpack(about.data);
  await prepare(about.run);
  [frames, ending] = [steps, about.ending];
  show(0);
})();
