"""Changes of a study before it is checked: `--set KEY=VALUE`, and tuned parameters."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxreplay.errors import ConfigError
from jaxreplay.machine import read_toml
from jaxreplay.study.factors import FACTORS
from jaxreplay.study.parse import number
from jaxreplay.study.worlds.world import listed


def apply(change: str, given: dict) -> None:
    """Replace one value of a study's description by `KEY=VALUE`.

    Raises:
        ValueError: it is not of that form.
    """
    key, equals, text = change.partition("=")
    path = key.strip().split(".")
    if not equals or not path[-1]:
        raise ValueError(f"--set {change}: give KEY=VALUE, such as axis.theta_i=[0.1, 0.01]")
    if "\n" in change or "\r" in change:
        raise ValueError(f"--set {change!r}: give one line, KEY=VALUE")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a word without its quotes
    except RecursionError:
        raise ValueError(f"--set {change[:40]}…: too deeply nested") from None
    put(value, given, path)


def put(value: Any, given: dict, path: list[str]) -> None:
    """Replace the value at a path of keys in a study's description."""
    *tables, last = path
    # A factor has either a value or an axis, and an axis one kind of spacing.
    if tables[:1] == ["axis"]:
        given.pop(path[1], None)
    elif not tables and isinstance(given.get("axis"), dict):
        given["axis"].pop(last, None)
    for name in tables:
        if not isinstance(given.get(name), dict):
            given[name] = {}
        given = given[name]
    if last in ("linspace", "logspace"):
        given.clear()
    given[last] = value


def tuned_values(path: Path, ranges: Mapping[str, float]) -> dict[str, float]:
    """Return tuned parameters as factors, each σ as a share of its sensor's range.

    Args:
        path: the file of parameters.
        ranges: of the sensors of the study in which they will be used.

    Raises:
        ConfigError: the file is missing or not TOML, or does not contain such parameters, or
            those of other sensors than the study's.
    """
    given = read_toml(path)
    sigma = given.get("sigma")
    if given.keys() != {"theta_i", "theta_tau", "sigma"} or not isinstance(sigma, dict):
        raise ConfigError(
            f"{path}: must contain theta_i, theta_tau and a table sigma, as jaxreplay tune saves "
            "them"
        )
    if sorted(sigma) != sorted(ranges):
        raise ConfigError(
            f"{path}: its sensors are {listed(list(sigma))}; the study's are {listed(list(ranges))}"
        )
    values = {}
    try:
        for name in ("theta_i", "theta_tau"):
            values[name] = FACTORS[name].read(given[name], name)
        for name, full in ranges.items():
            low, high = 1e-6 * full, 1e6 * full
            values[f"sigma_{name}"] = number(low, high)(sigma[name], f"sigma.{name}") / full
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None
    return values
