"""What a world can be told as it is started, checked."""

import difflib
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxreplay.plane.actuators import Settings
from jaxreplay.plane.params import PlaneParams

SETTINGS = {  # what may be told of a world, and between what
    "motor_unit": (1e-6, 0.3),
    "dithering": (0, 1),
    "battery": (0.05, 1.5),
    "sensor_noise": (0.0, 100.0),
}


def unknown(name: str, known: Sequence[str]) -> str:
    """The rest of a message about a name that is none of the known, which it tells."""
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    return f"{name}{hint} (known: {', '.join(known)})"


def seed_of(*key: int) -> int:
    """One seed from several numbers, as a study's seed and a run's place in it."""
    return int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0])


def seeds_of(seed: Any, n: int) -> list[int | None]:
    """One for each of n slots, as Gymnasium means it."""
    if isinstance(seed, int | np.integer):
        seed = [int(seed) + b for b in range(n)]
    seeds = [None] * n if seed is None else list(seed) if np.ndim(seed) == 1 else []
    whole = (k is None or (isinstance(k, int | np.integer) and k >= 0) for k in seeds)
    if len(seeds) != n or not all(whole):
        raise ValueError(
            f"seed must be one non-negative whole number, or one for each of {n} slots; got {seed}"
        )
    return seeds


def told(options: dict[str, Any], n: int, params: PlaneParams) -> tuple[np.ndarray, Settings]:
    """Cubes `[n, 3]` (NaN where not told of) and settings of n slots.

    Raises:
        ValueError: an option that is unknown, has the wrong shape or is out of range.
    """
    known = ["cube", *SETTINGS]
    for name in options:
        if name not in known:
            raise ValueError(f"unknown option {unknown(name, known)}")
    cubes = np.asarray(options.get("cube", np.full((n, 3), np.nan)), float)
    if cubes.shape != (n, 3) or ("cube" in options and not np.isfinite(cubes).all()):
        raise ValueError(f"cube must be {n} finite x, y (m) and angle (rad); got {cubes}")
    values = []
    for name, (low, high) in SETTINGS.items():
        value = np.asarray(options.get(name, np.full(n, getattr(params, name))), float)
        if value.shape != (n,) or not ((low <= value) & (value <= high)).all():
            raise ValueError(f"{name} must be {n} values in [{low:g}, {high:g}]; got {value}")
        if name == "dithering" and not np.isin(value, (0, 1)).all():
            raise ValueError(f"dithering must be on (1) or off (0); got {value}")
        values.append(value)
    return cubes, Settings(*values)
