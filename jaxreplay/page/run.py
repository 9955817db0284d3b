"""The page of one run: its data, packed, in an HTML file with a script that draws them."""

import gzip
import json
import warnings
from base64 import b64encode
from collections.abc import Sequence
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
from jaxreplay.records import Records
from jaxreplay.study.dataset import Pictures, PlaneScene, Trace

MOST_BYTES = 3_000_000  # of a page
_STEPS = 2000  # that are stored at most, evenly spaced over the run
_BIN = 4  # moments τ whose probabilities are added up in one pixel of the belief
_COLUMNS = 240  # of the belief at most
MOST_ROWS = 60  # records that are shown at most: those that are ever most probable
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
    shares = run.beliefs.sum(axis=2)
    rows = np.sort(np.argsort(-shares.max(axis=0), kind="stable")[:MOST_ROWS])
    about, arrays = (
        described(run, rows, run.observations, run.commands),
        steps_of(run, chosen, rows),
    )
    about["end"] = about["period"] * len(run.commands)
    followed = Followed()
    jumps = [t for t, p in enumerate(shares) if followed.jumps(p)]
    arrays["jump"] = np.isin(np.arange(len(chosen)), np.searchsorted(chosen, jumps))
    if isinstance(run.scene, Pictures):
        reduced = [reduced_picture(run.scene.files[t]) for t in chosen]
        about["pictures"] = list(dict.fromkeys(reduced))
        arrays["shown"] = np.array([about["pictures"].index(uri) for uri in reduced])
    return html(about, data=packed(arrays), ending=run.ending, speed=speed)


def html(run: dict[str, Any] | None, **more: Any) -> str:
    """Return the page with a description of a run (see :func:`described`), and more for it."""
    folder = files("jaxreplay.page")
    # In a script, "</" would end it.
    about = json.dumps({"run": run, **more}, allow_nan=False, ensure_ascii=False)
    return Template((folder / "page.html").read_text("utf-8")).substitute(
        title=escape(run["title"] if run else "explore"),
        style=(folder / "page.css").read_text("utf-8"),
        script=(folder / "page.js").read_text("utf-8"),
        about=about.replace("</", r"<\/"),
    )


def described(
    run: Trace, rows: np.ndarray, observations: np.ndarray, commands: np.ndarray
) -> dict[str, Any]:
    """Return what the script has to know of a whole run, beside its steps.

    Args:
        run: the run, or its first step.
        rows: the records that are shown.
        observations: `[T, n_s]`, to whose ranges the sensors' curves are scaled.
        commands: `[T, n_u]`, likewise.
    """
    values = ", ".join(f"{symbol} {short(value)}" for symbol, value in run.values.items())
    names = run.records.sensor_names, run.records.command_names
    params = run.scene.params if isinstance(run.scene, PlaneScene) else None
    drove = run.values.get("controller", "filter") == "filter"
    return {
        "title": values or "a run",
        "place": run.place,
        **timing(run.records, run.period, rows),
        "end": (run.period or 1) * run.records.longest,
        "whose": "followed:" if drove else "a filter, which did not drive, would follow:",
        "plane": params and drawn_with(params),
        "sensors": curves(observations, names[0]),
        "commands": curves(commands, names[1], params),
        "pictures": [],
    }


def timing(records: Records, period: float | None, rows: np.ndarray) -> dict[str, Any]:
    """Return the period, its unit, the records that are shown, and where they end."""
    apart = period or 1
    lengths = np.asarray(records.lengths)
    return {
        "period": apart,
        "unit": "s" if period else "steps",
        "taus": apart * _wide(records.longest) * -(-records.longest // _wide(records.longest)),
        "rows": rows.tolist(),
        "records": records.n_records,
        "ends": (apart * lengths[rows]).tolist(),
    }


def steps_of(run: Trace, chosen: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Return some steps of a run as they are drawn: beliefs of some records, and all the rest."""
    arrays = {
        "step": chosen + 1,
        "sensors": run.observations[chosen, :_CURVES],
        "commands": run.commands[chosen, :_CURVES],
        **belief_arrays(run.beliefs[chosen], rows, run.period),
    }
    if isinstance(run.scene, PlaneScene):
        pose = Pose(*(each[chosen] for each in run.scene[:4]))
        arrays |= pose_arrays(run.scene.params, pose, run.scene.held[chosen])
    return arrays


class Followed:
    """The record that is followed: until another one is `_CLEARLY` times as probable."""

    def __init__(self):
        """Follow none yet."""
        self._record: int | None = None

    def jumps(self, p: np.ndarray) -> bool:
        """Take in p(I) `[N]` of the next step, and return whether another record is followed."""
        before = self._record
        if before is None or p.max() >= _CLEARLY * p[before]:
            self._record = int(p.argmax())
        return before not in (None, self._record)


def _wide(longest: int) -> int:
    """Return how many moments τ are added up in one pixel of the belief."""
    return max(min(_BIN, longest // 20), -(-longest // _COLUMNS), 1)


def belief_arrays(
    beliefs: np.ndarray, rows: np.ndarray, period: float | None
) -> dict[str, np.ndarray]:
    """Return beliefs `[T, N, L]` as they are drawn: p(I), and the fourth root of p(I, τ).

    Probabilities are stored as 0 … 65535 and their roots as 0 … 255; of neighbouring moments the
    sum. `followed` is the most probable record and its p(I), `tau` its mean moment.
    """
    n_steps, _, longest = beliefs.shape
    width, shares = _wide(longest), beliefs.sum(axis=2)
    columns = -(-longest // width)
    padded = np.pad(beliefs[:, rows], ((0, 0), (0, 0), (0, columns * width - longest)))
    summed = padded.reshape(n_steps, len(rows), columns, width).sum(axis=3)
    best = shares.argmax(axis=1)
    of_best = beliefs[np.arange(n_steps), best]
    return {
        "share": np.rint(65535 * np.clip(shares[:, rows], 0, 1)).astype(np.uint16),
        "belief": np.rint(255 * np.clip(summed, 0, 1) ** 0.25).astype(np.uint8),
        "followed": np.column_stack([best, shares.max(axis=1)]),
        "tau": (period or 1) * (of_best @ np.arange(longest)) / of_best.sum(axis=1),
    }


def pose_arrays(params: PlaneParams, pose: Pose, held: np.ndarray) -> dict[str, np.ndarray]:
    """Return robots, cubes and grippers of T steps as they are drawn."""
    raised = (pose.elevation - params.low) / (params.high - params.low)
    return {
        "robot": pose.robot,
        "cube": pose.cube,
        "raised": np.clip(raised, 0, 1),
        "beams": beams(params, pose).reshape(len(held), -1),
        "held": held,
    }


def drawn_with(params: PlaneParams) -> dict[str, Any]:
    """Return the constants with which the plane is drawn, m and rad."""
    return {
        "area": params.area, "hull": params.hull_radius, "reach": params.reach,
        "gripper": params.gripper_width, "side": params.side, "view": params.field_of_view,
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


def reduced_picture(encoded: bytes) -> str:
    """Return a picture as the address of a JPEG of `_PICTURE` pixels at most."""
    picture = Image.open(BytesIO(encoded)).convert("RGB")
    picture.thumbnail((_PICTURE, _PICTURE))
    file = BytesIO()
    picture.save(file, "JPEG", quality=70)
    return f"data:image/jpeg;base64,{b64encode(file.getvalue()).decode()}"


def curves(
    values: np.ndarray, names: Sequence[str], params: PlaneParams | None = None
) -> dict[str, Any]:
    """Return how columns of `[T, n]` values are drawn: their names, lowest values and spans.

    With `params`, they are the plane's commands.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a column without any number
        low, high = (np.nan_to_num(f(values, axis=0)) for f in (np.nanmin, np.nanmax))
    span = high - low
    scale = "each from its lowest to its highest value"
    if params is not None:
        low = np.array([0, 0, params.low, 0, 0])
        span = np.array([0.05, 0.05, params.high - params.low, params.scanning_tilt, 1])
        scale = "tracks in units of 5 cm/s, gripper as a share of its travel"
    span = np.where(span > 0, span, 1.0)
    scaled = (values - low) / span
    if len(names) > _CURVES:
        scale += f" ({_CURVES} of {len(names)})"
    return {
        "names": [name.replace("_", " ") for name in names[:_CURVES]],
        "low": low.tolist(),
        "span": span.tolist(),
        "least": float(min(0.0, np.nan_to_num(scaled[:, :_CURVES]).min()) - 0.05),
        "scale": scale,
    }


def packed(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return arrays as one compressed text, and each one's name, type, shape and place in it."""
    stored = {name: _stored(np.asarray(array)) for name, array in arrays.items()}
    listed, parts, offset = [], [], 0
    for name, array in sorted(stored.items(), key=lambda item: -item[1].itemsize):  # aligned
        listed.append([name, str(array.dtype), array.shape, offset])
        parts.append(np.ascontiguousarray(array).tobytes())
        offset += len(parts[-1])
    return {"arrays": listed, "packed": b64encode(gzip.compress(b"".join(parts), mtime=0)).decode()}


def _stored(array: np.ndarray) -> np.ndarray:
    """Return an array in a type that the script reads: float32, uint16 or uint8."""
    if array.dtype in (np.uint8, np.uint16):
        return array
    return array.astype(np.uint8 if array.dtype == bool else np.float32)
