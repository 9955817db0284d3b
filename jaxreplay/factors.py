"""What a study can vary, and what each may be."""

from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import numpy as np

from jaxreplay.filter import PREDICTIONS
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import SENSOR_NAMES, SENSOR_RANGES, PlaneParams


class Factor(NamedTuple):
    """Something a study can vary.

    Attributes:
        default: where nothing is said; `MUST` has to be said. None where nothing being said means
            something of its own: a sensor's σ is that of all, the records are all there are.
        read: a value as it stands in a study's file, and the key there, to what is meant; a
            ValueError with what is allowed if it is none.
        symbol: how tables and figures call it.
        units: of a number; empty for what is none.
        long_name: in words.
    """

    default: Any
    read: Callable[[Any, str], Any]
    symbol: str
    units: str
    long_name: str

    @property
    def numeric(self) -> bool:
        """Whether it is a number."""
        return self.units != ""


MUST = object()


def number(low: float, high: float) -> Callable[[Any, str], float]:
    """Reads a number within bounds."""

    def read(given: Any, key: str) -> float:
        if isinstance(given, bool) or not isinstance(given, int | float):
            raise ValueError(f"{key} must be a number; got {given!r}")
        if not low <= given <= high:
            raise ValueError(f"{key} must be in [{low:g}, {high:g}]; got {_short(given)}")
        return float(given)

    return read


def whole(low: int, high: int) -> Callable[[Any, str], int]:
    """Reads a whole number within bounds."""

    def read(given: Any, key: str) -> int:
        if isinstance(given, bool) or not isinstance(given, int) or not low <= given <= high:
            raise ValueError(
                f"{key} must be a whole number from {low} to {high}; got {_short(given)}"
            )
        return given

    return read


def one_of(*allowed: str | bool) -> Callable[[Any, str], str | bool]:
    """Reads one of some values."""
    told = ", ".join(repr(a) if isinstance(a, str) else str(a).lower() for a in allowed)

    def read(given: Any, key: str) -> str | bool:
        if type(given) is not type(allowed[0]) or given not in allowed:
            raise ValueError(f"{key} must be one of {told}; got {given!r}")
        return given

    return read


def some_records(given: Any, key: str) -> str:
    """Reads how many records, or which; see :func:`chosen_records`."""
    if isinstance(given, int) and not isinstance(given, bool):
        return f"{whole(1, 10_000)(given, key)} drawn"
    if not isinstance(given, list) or not given:
        raise ValueError(
            f"{key} must be how many records to draw, such as 6, or a list of their numbers, "
            f"such as [0, 4, 19]; got {given!r}"
        )
    which = [whole(0, 9_999)(k, f"{key}[{i}]") for i, k in enumerate(given)]
    if len(set(which)) != len(which):
        raise ValueError(f"{key} holds a record twice: {which}")
    return " ".join(map(str, which))


def chosen_records(told: str, n_records: int, *seed: int) -> list[int]:
    """The records that a value of the factor `records` stands for, as indices.

    Args:
        told: what :func:`some_records` gave.
        n_records: how many there are.
        seed: of the draw, where records are drawn.

    Raises:
        ValueError: there are not as many.
    """
    first, *others = told.split()
    if others == ["drawn"]:
        if int(first) > n_records:
            raise ValueError(f"records: {first} cannot be drawn from {n_records}")
        rng = np.random.default_rng([*seed, int(first)])
        return sorted(rng.choice(n_records, int(first), replace=False).tolist())
    which = [int(first), *map(int, others)]
    if max(which) >= n_records:
        raise ValueError(f"records: there is no {max(which)}; they are 0 to {n_records - 1}")
    return which


def _short(given: Any) -> str:
    return repr(given) if len(repr(given)) <= 40 else repr(given)[:40] + "…"


_PLANE = PlaneParams()
_SIGMA_OF = {  # a sensor, and what may tell its σ
    name: ("sigma", *(["sigma_proximeters"] if "proximeter" in name else []), f"sigma_{name}")
    for name in SENSOR_NAMES
}


FACTORS = {
    "theta_i": Factor(MUST, number(0, 1), "θ_I", "1", "probability to jump to another record"),
    "theta_tau": Factor(0.05, number(0, 0.5), "θ_τ", "1", "probability to stay, and to skip"),
    "sigma": Factor(0.1, number(1e-6, 1e6), "σ", "1", "σ of every sensor, as a share of its range"),
    **{
        f"sigma_{name}": Factor(
            None, number(1e-6, 1e6), f"σ {name}", "1", f"σ of {name}, as a share of the range"
        )
        for name in ("camera", "proximeters", *SENSOR_NAMES[1:])
    },
    "jump": Factor("same_tau", one_of(*PREDICTIONS), "jump", "", "reading of a jump"),
    "records": Factor(None, some_records, "records", "", "which of the demonstrations"),
    "light": Factor(None, one_of(False, True), "light", "", "one more sensor, of the room's light"),
    "dithering": Factor(
        _PLANE.dithering, one_of(False, True), "dithering", "", "temporal dithering of the tracks"
    ),
    "motor_unit": Factor(
        _PLANE.motor_unit,
        number(*SETTINGS["motor_unit"]),
        "motor unit",
        "m/s",
        "what track speeds round to",
    ),
    "battery": Factor(
        _PLANE.battery,
        number(*SETTINGS["battery"]),
        "battery",
        "1",
        "voltage, as a share of a full battery's",
    ),
    "sensor_noise": Factor(
        _PLANE.sensor_noise,
        number(*SETTINGS["sensor_noise"]),
        "sensor noise",
        "1",
        "factor on the sensors' noise",
    ),
}


def sigma_factors(said: Collection[str]) -> list[str]:
    """For each sensor the factor that tells its σ: the closest to it among those said."""
    return [[name for name in among if name in said][-1] for among in _SIGMA_OF.values()]


def sigma_of_sensors(values: dict[str, np.ndarray]) -> np.ndarray:
    """σ of each sensor in its own unit, `[n, n_s]`, from the factors' values in n runs."""
    said = {name for name, value in values.items() if value[0] is not None}
    columns = [values[name] for name in sigma_factors(said)]
    return np.stack(columns, axis=1).astype(float) * np.array(SENSOR_RANGES)
