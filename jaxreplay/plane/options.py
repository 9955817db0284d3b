"""Checks of the options and seeds given to `reset`, and their conversion to arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxreplay.errors import suggest
from jaxreplay.plane.actuators import Settings
from jaxreplay.plane.params import PlaneParams

SETTINGS: dict[str, tuple[float, float]] = {  # lowest and highest value, see `Settings`
    "motor_unit": (1e-6, 0.3),
    "dithering": (0, 1),
    "battery": (0.05, 1.5),
    "sensor_noise": (0.0, 100.0),
    "track_bias": (0.0, 0.9),
    "placing": (0.0, 0.05),
    "heading": (0.0, 1.0),
    "cube_turn": (0.0, 0.8),
    "push": (0.0, 0.3),
}


def seed_of(*key: int) -> int:
    """Return one seed made from several numbers, such as a study's seed and a run's index."""
    return int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0])


def seeds_of(seed: int | Sequence[int | None] | None, n: int) -> list[int | None]:
    """Return one seed for each of n slots, by Gymnasium's convention.

    From one number s they are s, s + 1, …; from None they are all None.

    Raises:
        ValueError: a seed is negative or no whole number, or there are not n of them.
    """
    seeds: list[int | None] = []
    if isinstance(seed, int | np.integer):
        seeds = [int(seed) + b for b in range(n)]
    elif seed is None:
        seeds = [None] * n
    elif np.asarray(seed).ndim == 1:
        seeds = list(seed)
    whole = (k is None or (isinstance(k, int | np.integer) and k >= 0) for k in seeds)
    if len(seeds) != n or not all(whole):
        raise ValueError(
            f"seed must be one non-negative whole number, or one for each of {n} slots; got {seed}"
        )
    return seeds


def parse_options(
    options: dict[str, Any], n: int, params: PlaneParams
) -> tuple[np.ndarray, Settings]:
    """Return the cubes `[n, 3]` and the settings of n slots.

    `reset_mask` is not among these options: the environment takes it out first. Cubes are NaN
    where the options do not place them; settings that the options do not contain are those of
    `params`.

    Raises:
        ValueError: an option is unknown, has the wrong shape or is out of range.
    """
    known = ["cube", *SETTINGS]
    for name in options:
        if name not in known:
            raise ValueError(f"unknown option {suggest(name, [*known, 'reset_mask'])}")
    cubes = np.asarray(options.get("cube", np.full((n, 3), np.nan)), float)
    if cubes.shape != (n, 3) or ("cube" in options and not np.isfinite(cubes).all()):
        raise ValueError(f"cube must be {n} finite x, y (m) and angle (rad); got {cubes}")
    (x, y, angle), half = cubes.T, params.side / 2
    seen = np.stack([np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x])
    gap = np.hypot(*np.maximum(np.abs(seen) - half, 0))  # of the robot's centre to the cube
    if (gap < params.hull_radius).any():
        raise ValueError(f"cube is on the robot, which starts at (0, 0); got {cubes}")
    values = []
    for name, (low, high) in SETTINGS.items():
        value = np.asarray(options.get(name, np.full(n, getattr(params, name))), float)
        if value.shape != (n,) or not ((low <= value) & (value <= high)).all():
            raise ValueError(f"{name} must be {n} values in [{low:g}, {high:g}]; got {value}")
        if name == "dithering" and not np.isin(value, (0, 1)).all():
            raise ValueError(f"dithering must be on (1) or off (0); got {value}")
        values.append(value)
    return cubes, Settings(*values)
