"""Runs that are asked for: what can be changed, and a run that is sent while it is computed."""

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from time import monotonic
from typing import Any

import numpy as np

from jaxreplay.figures.table import short
from jaxreplay.loop.rivals import CONTROLLERS
from jaxreplay.page.run import (
    MOST_ROWS,
    Followed,
    described,
    packed,
    reduced_picture,
    steps_of,
)
from jaxreplay.records import Records
from jaxreplay.study.again import Step, run_again
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.dataset import Pictures, Trace
from jaxreplay.study.factors import sigma_factors
from jaxreplay.study.runs import Demonstrations, runs_of

_APART = 0.03  # s between two messages at least
_NEEDS = {"cloning": "sklearn", "regression": "gmr"}  # packages of an extra

Send = Callable[[dict[str, Any]], None]


class CancelledError(BaseException):  # no error of an environment, so not caught as one
    """Another run was asked for."""


def controls(config: StudyConfig, values: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what can be changed of a run: each with its name, label, and range or choices.

    Args:
        config: the study, whose own values can be chosen too.
        values: of a run, see :func:`values_of`.
    """

    def slider(name: str, label: str, low: float, high: float, step: float, log: bool = False):
        if log and (own := [value for value in config.values_of(name) if value]):
            low = min(low, float(np.floor(np.log10(min(own)))))
        return {"name": name, "label": label, "range": [low, high, step], "log": log}

    def choice(name: str, label: str, *usual: Any):
        choices = list(dict.fromkeys([*usual, *config.values_of(name)]))
        return {"name": name, "label": label, "choices": choices}

    drivers = [name for name in CONTROLLERS if find_spec(_NEEDS.get(name, "numpy"))]
    given = {name for name, value in values.items() if value is not None}
    sensors, factors = config.world.sensor_names or (), config.world.factors
    sigmas = list(dict.fromkeys(sigma_factors(given, sensors, config.world.groups))) or ["sigma"]
    found = [
        slider("theta_i", "θ_I", -6, 0, 0.25, log=True),
        slider("theta_tau", "θ_τ", 0, 0.5, 0.01),
        *(
            slider(name, f"{factors[name].symbol}, share", -2.5, 1, 0.1, log=True)
            for name in sigmas
        ),
        choice("jump", "reading of a jump", "own_tau", "same_tau"),
        choice("controller", "controller", *drivers),
    ]
    if config.environment is None:
        found += [
            choice("motor_unit", "motor unit, m/s", 0.0025, 0.005, 0.01, 0.02),
            choice("dithering", "dithering", False, True),
            slider("track_bias", "track bias", 0, 0.3, 0.01),
            slider("push", "push on the way, m", 0, 0.1, 0.01),
        ]
    return found


def values_of(config: StudyConfig, k: int) -> dict[str, Any]:
    """Return the values of a run of a study: of all factors, position, repeat and cube."""
    runs = runs_of(config)
    values = {name: _plain(column[k]) for name, column in runs.values.items()}
    for name in ("sigma_camera", "sigma_proximeters"):
        if name in values and values[name] is None:
            values[name] = values["sigma"]
    position = int(runs.position[k])
    cube = list(config.positions[position]) if config.positions else None
    return {**values, "position": position, "repeat": int(runs.repeat[k]), "cube": cube}


def titled(config: StudyConfig, values: dict[str, Any]) -> str:
    """Return which run of a study has these values, in words."""
    factors = config.world.factors
    varied = [f"{factors[name].symbol} {short(values[name])}" for name in config.axes]
    place = [f"position {values['position']}"] if config.positions else []
    return ", ".join([*varied, *place, f"repeat {values['repeat']}"])


def asked(config: StudyConfig, values: dict[str, Any]) -> tuple[StudyConfig, int]:
    """Return a study of one cell with these values, and the index of the run in it.

    Its world is that of the study's run with the same position and repeat.

    Raises:
        ConfigError: a value is not possible.
    """
    factors = {name: value for name, value in values.items() if name in config.world.factors}
    position, repeat = int(values["position"]), int(values["repeat"])
    positions = list(config.positions)
    if positions and values.get("cube"):
        x, y = values["cube"]
        positions[position] = float(x), float(y)
    one = replace(
        config, axes={}, zip=(), fixed={**config.fixed, **factors}, positions=tuple(positions),
        repeats=max(config.repeats, repeat + 1),
    )  # fmt: skip
    return one, position * one.repeats + repeat


def stream(
    config: StudyConfig,
    demonstrations: Demonstrations,
    k: int,
    title: str,
    send: Send,
    go: Callable[[], bool],
) -> Trace:
    """Do a run, and send its description and its steps while it is computed.

    Args:
        config: the study.
        demonstrations: its records.
        k: the run's index.
        title: of the run.
        send: called with each message.
        go: whether the run is still wanted.

    Raises:
        CancelledError: `go` returned False.
    """
    sent, followed, waiting, done = monotonic(), Followed(), [], 0
    rows, driver = np.zeros(0, int), f"{runs_of(config).values['controller'][k]}"

    def flush(records: Records) -> None:
        nonlocal sent, done, rows
        first, sent = done == 0, monotonic()
        part = _part(config, records, waiting)._replace(values={"controller": driver})
        if first:
            rows = np.arange(min(records.n_records, MOST_ROWS))
            ranges = (np.concatenate(each) for each in records.sequences(filled=True))
            about = described(part, rows, *ranges) | {"title": title}
            send({"kind": "run", "run": about})
        arrays = steps_of(part, np.arange(len(waiting)), rows)
        arrays["step"] = arrays["step"] + done
        arrays["jump"] = np.array([followed.jumps(p) for p in part.beliefs.sum(axis=2)])
        pictures = []
        if isinstance(part.scene, Pictures):
            pictures = [reduced_picture(encoded) for encoded in part.scene.files]
            arrays["shown"] = np.arange(len(pictures)) + done
        send({"kind": "steps", "data": packed(arrays), "pictures": pictures})
        done += len(waiting)
        waiting.clear()

    def follow(records: Records, step: Step) -> None:
        if not go():
            raise CancelledError
        waiting.append(step)
        if done == 0 or monotonic() - sent > _APART:
            flush(records)

    run = run_again(config, demonstrations, k, follow)
    if waiting:
        flush(run.records)
    return run


def _part(config: StudyConfig, records: Records, steps: list[Step]) -> Trace:
    """Return some steps of a run that has not ended."""
    observations, commands, beliefs, seen = (list(each) for each in zip(*steps, strict=True))
    period = records.period
    if config.environment is None:
        period = config.plane.control_period
    return Trace(
        observations=np.array(observations),
        commands=np.array(commands),
        beliefs=np.array(beliefs),
        records=records,
        ending="",
        period=period,
        scene=config.world.scene(seen),
    )


def _plain(value: Any) -> Any:
    """Return NumPy's scalars as Python's, which JSON stores."""
    return value.item() if isinstance(value, np.generic) else value
