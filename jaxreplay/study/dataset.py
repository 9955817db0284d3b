"""What the dataset of a study contains, for those who make it and those who draw it.

Dimensions are the study's axes, then `position` (on the plane) and `repeat`. Every factor with a
value is a coordinate: along its axis, or a scalar where it is fixed. Its attributes `symbol`,
`long_name` and, of a number, `units` say how to write it.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxreplay.plane.params import PlaneParams
from jaxreplay.records import Records

VARIABLES: dict[str, dict[str, str]] = {  # of every study, beside those of its world
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


def variables_of(
    outcomes: Mapping[str, str], own: Mapping[str, Mapping[str, str]]
) -> dict[str, Mapping[str, str]]:
    """Return the attributes of all variables of a study, by name.

    Args:
        outcomes: of its world: codes and their meanings.
        own: the world's own variables.
    """
    outcome = {
        "long_name": "outcome of the run",
        "values": " ".join(outcomes),
        "meanings": "; ".join(outcomes.values()),
    }
    return {"outcome": outcome, **own, **VARIABLES}


def dtype_of(about: Mapping[str, str]) -> str:
    """Return the type of a variable with these attributes: float, or text that fits its words."""
    return f"<U{max(map(len, about['values'].split()))}" if "values" in about else "float64"


class PlaneScene(NamedTuple):
    """What there was to see on the plane in T control steps.

    Attributes:
        robot: `[T, 3]` x, y (m) and heading (rad).
        cube: `[T, 3]` x, y (m) and angle (rad).
        elevation: `[T]` of the gripper head, m.
        tilt: `[T]` of the gripper head, rad.
        held: `[T]` whether the magnet held the cube.
        params: the constants of the simulated robot and its surroundings.
    """

    robot: np.ndarray
    cube: np.ndarray
    elevation: np.ndarray
    tilt: np.ndarray
    held: np.ndarray
    params: PlaneParams = PlaneParams()


class Pictures(NamedTuple):
    """Pictures of an environment, one for each of T control steps.

    Attributes:
        files: each as the bytes of a PNG file.
    """

    files: list[bytes]


class Trace(NamedTuple):
    """One run of T control steps, step by step, and how it ended.

    Attributes:
        observations: `[T, n_s]`.
        commands: `[T, n_u]`.
        beliefs: `[T, N, L]` p(I, τ | Z_1:t).
        records: those replayed.
        ending: how it ended, such as "S, error 2.3 mm".
        period: s between control steps; None: unknown.
        scene: what there was to see; None: nothing.
        values: the factors' values by symbol, for a run of a study.
        place: its position and repeat in the study, in words.
    """

    observations: np.ndarray
    commands: np.ndarray
    beliefs: np.ndarray
    records: Records
    ending: str
    period: float | None
    scene: PlaneScene | Pictures | None
    values: Mapping[str, Any] = MappingProxyType({})
    place: str = ""


def words(dataset: xr.Dataset, name: str) -> list[str]:
    """Return the values that a variable of words can have; none if the dataset has no such."""
    return dataset[name].attrs["values"].split() if name in dataset else []


def meanings(dataset: xr.Dataset) -> dict[str, str]:
    """Return how a run can end: each outcome's code, and what it means."""
    return dict(
        zip(words(dataset, "outcome"), dataset.outcome.attrs["meanings"].split("; "), strict=True)
    )


def told(dataset: xr.Dataset) -> list[str]:
    """Return the variables that tables and figures show."""
    return [str(name) for name, values in dataset.data_vars.items() if "column" in values.attrs]


SAMPLES = ("position", "repeat")  # dimensions along which no factor varies


def axes_of(dataset: xr.Dataset) -> list[str]:
    """Return the dimensions along which factors vary."""
    return [str(dim) for dim in dataset.outcome.dims if dim not in SAMPLES]


def samples_of(dataset: xr.Dataset) -> list[str]:
    """Return the dimensions of the runs that a cell has: positions, if any, and repeats."""
    return [str(dim) for dim in dataset.outcome.dims if dim in SAMPLES]


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
