"""The page of one run: its data, packed, in an HTML file with a script that draws them."""

import gzip
import json
from base64 import b64encode
from html import escape
from importlib.resources import files
from io import BytesIO
from string import Template
from typing import Any

import numpy as np
from PIL import Image

from jaxreplay.figures.table import short
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose, proximeter_rays, ray_to_square
from jaxreplay.study.dataset import Pictures, PlaneScene, Trace

MOST_BYTES = 3_000_000  # of a page
_STEPS = 2000  # that are stored at most, evenly spaced over the run
_BIN = 4  # moments τ whose probabilities are added up in one pixel of the belief
_COLUMNS = 240  # of the belief at most
_ROWS = 60  # records that are shown at most: those that are ever most probable
_CURVES = 10  # sensors, or commands, that are drawn at most
_PICTURE = 420  # width of an environment's pictures at most, pixels
_CLEARLY = 2.0  # times as probable as the record followed is one that is followed instead


def page(run: Trace, speed: float = 4.0) -> str:
    """Return an HTML page that plays a run: the world, the belief, sensors and commands.

    It needs nothing from outside, and has at most `MOST_BYTES`: of a long run every second step is
    stored, or every fourth, and so on.

    Args:
        run: the run.
        speed: at first, as a multiple of real time.
    """
    apart = -(-len(run.commands) // _STEPS)
    while len(text := _page(run, speed, apart)) > MOST_BYTES and apart < len(run.commands):
        apart *= 2
    return text


def _page(run: Trace, speed: float, apart: int) -> str:
    """Return the page with the last step, and each that is a multiple of `apart` before it."""
    chosen = np.arange(len(run.commands))[::-1][::apart][::-1]
    about, arrays = _data(run, chosen)
    about |= {"speed": speed, "steps": (chosen + 1).tolist(), **_packed(arrays)}
    values = ", ".join(f"{symbol} {short(value)}" for symbol, value in run.values.items())
    folder = files("jaxreplay.page")
    # In a script, "</" would end it.
    safe = json.dumps(about, allow_nan=False, ensure_ascii=False).replace("</", r"<\/")
    return Template((folder / "page.html").read_text("utf-8")).substitute(
        title=escape(values or "a run"),
        place=escape(run.place),
        style=(folder / "page.css").read_text("utf-8"),
        script=(folder / "page.js").read_text("utf-8"),
        about=safe,
    )


def _data(run: Trace, chosen: np.ndarray) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return what the script needs of the chosen steps: a description, and arrays by name."""
    lengths = np.asarray(run.records.lengths)
    period, unit = (run.period, "s") if run.period else (1, "steps")
    shares = run.beliefs.sum(axis=2)
    rows = _rows(shares)
    belief, width = _binned(run.beliefs[chosen][:, rows])
    of_followed = run.beliefs[np.arange(len(shares)), shares.argmax(axis=1)]
    moments = of_followed @ np.arange(of_followed.shape[1]) / of_followed.sum(axis=1)
    arrays = {
        "tau": (period * moments[chosen]).astype(np.float32),
        "sensors": run.observations[chosen, :_CURVES].astype(np.float32),
        "commands": run.commands[chosen, :_CURVES].astype(np.float32),
        "share": np.rint(65535 * shares[chosen][:, rows]).astype(np.uint16),
        "belief": belief,
    }
    plane, pictures = None, {"pictures": [], "shown": []}
    if isinstance(run.scene, PlaneScene):
        plane = _plane(run.scene, chosen, arrays)
    elif isinstance(run.scene, Pictures):
        pictures = _pictures(run.scene.files, chosen)
    drove = run.values.get("controller", "filter") == "filter"
    about = {
        "period": period,
        "unit": unit,
        "end": period * len(run.commands),
        "taus": period * width,
        "rows": rows.tolist(),
        "ends": (period * lengths[rows]).tolist(),
        "whose": "followed:" if drove else "a filter, which did not drive, would follow:",
        "jumps": np.searchsorted(chosen, jumps(shares)).tolist(),
        "ending": run.ending,
        "plane": plane,
        "sensors": _scales(run.observations, run.records.sensor_names, None),
        "commands": _scales(run.commands, run.records.command_names, run.scene),
        **pictures,
    }
    return about, arrays


def jumps(shares: np.ndarray) -> list[int]:
    """Return the steps at which another record is followed than before, by p(I) `[T, N]`.

    A record is followed until another one is `_CLEARLY` times as probable.
    """
    followed, found = int(shares[0].argmax()), []
    for t, p in enumerate(shares):
        if p.max() >= _CLEARLY * p[followed] and p.argmax() != followed:
            followed = int(p.argmax())
            found.append(t)
    return found


def _rows(shares: np.ndarray) -> np.ndarray:
    """Return the records that are shown, in order: the `_ROWS` with the largest p(I) in the run."""
    return np.sort(np.argsort(-shares.max(axis=0), kind="stable")[:_ROWS])


def _binned(beliefs: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the fourth root of beliefs `[T, N, L]` as 0 … 255, and how many moments that is wide.

    Neighbouring moments are added up, as a pixel each.
    """
    n_steps, n, longest = beliefs.shape
    width = max(min(_BIN, longest // 20), -(-longest // _COLUMNS), 1)
    whole = -(-longest // width) * width
    padded = np.pad(beliefs, ((0, 0), (0, 0), (0, whole - longest)))
    summed = padded.reshape(n_steps, n, -1, width).sum(axis=3)
    return np.rint(255 * np.clip(summed, 0, 1) ** 0.25).astype(np.uint8), whole


def _plane(scene: PlaneScene, chosen: np.ndarray, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Add the poses to the arrays, and return the constants with which they are drawn."""
    p = scene.params
    pose = Pose(*(each[chosen] for each in scene[:4]))
    arrays["robot"], arrays["cube"] = (x.astype(np.float32) for x in (pose.robot, pose.cube))
    raised = (pose.elevation - p.low) / (p.high - p.low)
    arrays["raised"] = np.clip(raised, 0, 1).astype(np.float32)
    arrays["beams"] = beams(p, pose).astype(np.float32)
    arrays["held"] = scene.held[chosen].astype(np.uint8)
    return {
        "area": p.area, "hull": p.hull_radius, "reach": p.reach, "gripper": p.gripper_width,
        "side": p.side, "view": p.field_of_view,
    }  # fmt: skip


def beams(params: PlaneParams, pose: Pose) -> np.ndarray:
    """Return where the proximeters' beams begin and end, seen from above: `[T, 6, 4]` x, y, x, y.

    A beam that points up is as long as it looks from above.
    """
    x, y, angle = rays = proximeter_rays(params, pose)
    shown = np.cos(np.minimum(params.scanning_tilt - pose.tilt, np.pi / 2))[:, None]
    length = shown * np.minimum(
        ray_to_square(*rays, pose.cube, params.side), params.proximeter_range
    )
    return np.stack([x, y, x + length * np.cos(angle), y + length * np.sin(angle)], axis=2)


def _pictures(encoded: list[bytes], chosen: np.ndarray) -> dict[str, Any]:
    """Return the chosen pictures, reduced, and which of them is shown at each step."""
    uris: dict[str, int] = {}
    shown = [uris.setdefault(_reduced(encoded[t]), len(uris)) for t in chosen]
    return {"pictures": list(uris), "shown": shown}


def _reduced(encoded: bytes) -> str:
    """Return a picture as the address of a JPEG of `_PICTURE` pixels at most."""
    picture = Image.open(BytesIO(encoded)).convert("RGB")
    picture.thumbnail((_PICTURE, _PICTURE))
    file = BytesIO()
    picture.save(file, "JPEG", quality=70)
    return f"data:image/jpeg;base64,{b64encode(file.getvalue()).decode()}"


def _scales(values: np.ndarray, names, scene) -> dict[str, Any]:
    """Return how curves of `[T, n]` values are drawn: names, lowest value and span of each."""
    low, span = values.min(axis=0), np.ptp(values, axis=0)
    scale = "each from its lowest to its highest value"
    if isinstance(scene, PlaneScene):
        p = scene.params
        low, span = np.array([0, 0, p.low, 0, 0]), [0.05, 0.05, p.high - p.low, p.scanning_tilt, 1]
        scale = "tracks in units of 5 cm/s, gripper as a share of its travel"
    span = np.where(np.array(span) > 0, span, 1.0)
    scaled = (values - low) / span
    if len(names) > _CURVES:
        scale += f" ({_CURVES} of {len(names)})"
    return {
        "names": [name.replace("_", " ") for name in names[:_CURVES]],
        "low": low.tolist(),
        "span": span.tolist(),
        "least": float(min(0.0, scaled[:, :_CURVES].min()) - 0.05),
        "scale": scale,
    }


def _packed(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return arrays as one compressed text, and each one's name, type, shape and place in it."""
    listed, parts, offset = [], [], 0
    for name, array in sorted(arrays.items(), key=lambda item: -item[1].itemsize):  # aligned
        listed.append([name, str(array.dtype), array.shape, offset])
        parts.append(np.ascontiguousarray(array).tobytes())
        offset += len(parts[-1])
    return {"arrays": listed, "data": b64encode(gzip.compress(b"".join(parts), mtime=0)).decode()}
