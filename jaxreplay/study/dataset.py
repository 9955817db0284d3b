"""What the dataset of a study contains, for those who make it and those who draw it.

Dimensions are the study's axes, then `position` and `repeat`. Every factor with a value is a
coordinate: along its axis, or a scalar where it is fixed. Its attributes `symbol`, `long_name` and,
of a number, `units` say how to write it.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxreplay.plane.params import PlaneParams

OUTCOMES = ("S", "Fs", "Fg", "Fb")  # of a run, as in figure 3
STALLS = ("fixed", "cyclic", "slow")  # kinds of an Fs

VARIABLES: dict[str, dict[str, str]] = {
    "outcome": {"long_name": "outcome of the run", "values": " ".join(OUTCOMES)},
    "stall": {"long_name": "kind of an Fs", "values": " ".join(STALLS)},
    "lifted": {"units": "1", "long_name": "the cube was lifted at any time"},
    "alignment_error": {"units": "mm", "long_name": "alignment error"},
    "duration": {"units": "s", "long_name": "run duration"},
    "log_evidence": {"units": "1", "long_name": "log p(Z_1:t) of the run"},
    "widened": {"units": "1", "long_name": "steps computed again in a wider window"},
    "dropped": {
        "units": "bit",
        "long_name": "log2 of the largest probability that a window discarded",
    },
    "total_variation": {
        "units": "1",
        "long_name": "largest total variation distance between windowed and complete belief",
    },
    "command_error": {
        "units": "1",
        "long_name": "largest difference of a command, windowed and complete, as a share of its "
        "range",
    },
}
SINCE = {"lifted": 2}  # the results format that first had a variable
TEXT = {"outcome": "<U2", "stall": "<U6"}  # variables that are words, and their type


class Trace(NamedTuple):
    """One run of T control steps, step by step, and how it ended.

    Attributes:
        observations: `[T, n_s]`.
        commands: `[T, n_u]`.
        beliefs: `[T, N, L]` p(I, τ | Z_1:t).
        robot: `[T, 3]` x, y (m) and heading (rad).
        cube: `[T, 3]` x, y (m) and angle (rad).
        elevation: `[T]` of the gripper head, m.
        tilt: `[T]` of the gripper head, rad.
        held: `[T]` whether the magnet held the cube.
        lengths: `[N]` of the records.
        outcome: one of `OUTCOMES`.
        stall: one of `STALLS` if the outcome is Fs, else empty.
        alignment_error: m; NaN unless the magnet took hold of the cube.
        values: the factors' values by symbol, for a run of a study.
        position: index of the test position, for a run of a study.
        repeat: for a run of a study.
        plane: the constants of the simulated robot and its surroundings.
    """

    observations: np.ndarray
    commands: np.ndarray
    beliefs: np.ndarray
    robot: np.ndarray
    cube: np.ndarray
    elevation: np.ndarray
    tilt: np.ndarray
    held: np.ndarray
    lengths: np.ndarray
    outcome: str
    stall: str
    alignment_error: float
    values: Mapping[str, Any] = MappingProxyType({})
    position: int = 0
    repeat: int = 0
    plane: PlaneParams = PlaneParams()


def axes_of(dataset: xr.Dataset) -> list[str]:
    """Return the dimensions along which factors vary."""
    return [str(dim) for dim in dataset.outcome.dims if dim not in ("position", "repeat")]


def along(dataset: xr.Dataset, dim: str) -> list[str]:
    """Return the factors that vary along a dimension, its own first."""
    names = [str(name) for name, coord in dataset.coords.items() if "symbol" in coord.attrs]
    return sorted((n for n in names if dataset[n].dims == (dim,)), key=lambda n: n != dim)


def is_number(dataset: xr.Dataset, name: str) -> bool:
    """Return whether a factor is a number."""
    return "units" in dataset[name].attrs


def cells(dataset: xr.Dataset, dims: list[str]) -> Iterator[tuple[dict[str, Any], xr.Dataset]]:
    """Yield each combination of values along some dimensions: factors' values, and its runs."""
    sizes = [dataset.sizes[dim] for dim in dims]
    for index in np.ndindex(*sizes):
        at = dict(zip(dims, index, strict=True))
        values = {
            name: dataset[name].values[k] for dim, k in at.items() for name in along(dataset, dim)
        }
        yield values, dataset.isel(at)
