"""One run of a study done again, and recorded step by step."""

from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from gymnasium.vector import VectorEnv, VectorWrapper

from jaxreplay.errors import ConfigError
from jaxreplay.filter import build_filter
from jaxreplay.filter.options import Options
from jaxreplay.loop.controller import FilterController, MakeController
from jaxreplay.loop.replay import replay
from jaxreplay.loop.rivals import controller_named
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.dataset import Trace
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import config_of, open_study
from jaxreplay.study.runs import Demonstrations, records_of, runs_of, settings_of, worlds_of
from jaxreplay.study.shard import how_of
from jaxreplay.study.store import check_format, content_of, read_manifest
from jaxreplay.study.worlds.world import World

# Factors of a run that are shown; the others are if they have not their default.
ALWAYS = ("theta_i", "theta_tau", "sigma", "jump")


def find_and_run_again(
    study: StudyConfig | Path, run: int | str | Mapping[str, Any], folder: Path
) -> tuple[int, Trace]:
    """Find a run of a study, do it again and record it.

    Args:
        study: the folder of a study, or the description of one, which need not have been run.
        run: which, as in :func:`find_run`.
        folder: where demonstrations are looked for, and stored if they have to be made.

    Returns:
        The run's index, and the run.

    Raises:
        ConfigError: there is no such run; or the folder's study is damaged, or of another results
            format.
        FileNotFoundError: there is no study in the folder.
    """
    if isinstance(study, StudyConfig):
        config, dataset = study, None
    else:
        check_format(study)  # a run of another format would be another run
        try:
            dataset = open_study(study)
        except ValueError as error:
            raise ConfigError(str(error)) from None
        config = config_of(dataset)
    k = find_run(config, run, dataset)
    records = demonstrations(config, folder)
    if isinstance(study, Path) and content_of(records) != read_manifest(study)["demonstrations"]:
        raise ConfigError(
            f"the demonstrations of {study} are not those with which it was run: put the file back "
            "as it was"
        )
    return k, run_again(config, records, k)


def run_again(config: StudyConfig, demonstrations: Demonstrations, k: int) -> Trace:
    """Do the k-th run of a study again and record it.

    Args:
        config: the study.
        demonstrations: its records.
        k: the run's index, counted along the dataset's dimensions.

    Returns:
        The run. With the same records, results format and kind of processor it is identical to
        the study's run, bit for bit.
    """
    one, factors = runs_of(config).of(np.array([k])), config.world.factors
    params, (seed,), options = settings_of(config, demonstrations, one)
    how, chosen = how_of(one), records_of(config, demonstrations, one)
    controller = controller_named(one.values["controller"][0])
    with closing(worlds_of(config, one, render=True)) as worlds, config.world.failures():
        trace = trace_of(config.world, chosen, params, worlds, how, seed, options, controller)
    values = {
        factors[name].symbol: value
        for name, (value,) in one.values.items()
        if name in (*ALWAYS, *config.axes) or value not in (None, factors[name].default)
    }
    place = f"position {one.position[0]}, " if config.positions else ""
    return trace._replace(values=values, place=f"{place}repeat {one.repeat[0]}")


def find_run(
    config: StudyConfig, run: int | str | Mapping[str, Any], dataset: xr.Dataset | None = None
) -> int:
    """Return the index of a run, counted along the dataset's dimensions.

    Args:
        config: the study.
        run: the index itself; an outcome or a stall, for the first run that ended so; or values
            of factors, of `position` and of `repeat`, for the first run that has them all.
        dataset: the study's, for runs chosen by how they ended.

    Raises:
        ConfigError: there is no such run.
    """
    if isinstance(run, Mapping):
        return _with_values(config, run)
    runs, text = len(runs_of(config)), str(run)
    if text.isdecimal():
        if int(text) >= runs:
            raise ConfigError(f"run {text}: the study has {runs} runs; give 0 to {runs - 1}")
        return int(text)
    stalls = config.world.variables.get("stall", {}).get("values", "")
    known = [*config.world.outcomes, *stalls.split()]
    if text not in known:
        names = ", ".join(known)
        raise ConfigError(
            f"run {text}: give a run's number, or one of {names}, or values such as "
            "theta_i=0.01,position=0"
        )
    if dataset is None:
        raise ConfigError(f"run {text}: the study has no outcomes yet; give a study's folder")
    how = [dataset[name].values.ravel() for name in ("outcome", "stall") if name in dataset]
    found = np.flatnonzero(np.any([each == text for each in how], axis=0))
    if len(found) == 0:
        raise ConfigError(f"run {text}: no run of this study ended so")
    return int(found[0])


def _with_values(config: StudyConfig, wanted: Mapping[str, Any]) -> int:
    """Return the index of the first run with these values."""
    runs = runs_of(config)
    places = {"position": runs.position} if config.positions else {}
    columns = runs.values | places | {"repeat": runs.repeat}
    fits = np.full(len(runs), True)
    for name, value in wanted.items():
        if name not in columns:
            known = ", ".join((*config.axes, *places, "repeat"))
            raise ConfigError(
                f"run {name}={value}: the study has no {name}; what varies is {known}"
            )
        column = columns[name]
        value = _as_stored(config, name, value)
        same = np.array([_same(value, each) for each in column.tolist()])
        if not same.any():
            there = ", ".join(dict.fromkeys(f"{each}" for each in column.tolist()))
            raise ConfigError(f"run {name}={value}: the study's values are {there}")
        fits &= same
    if not fits.any():
        raise ConfigError(f"run {dict(wanted)}: no run of this study has all these values")
    return int(np.flatnonzero(fits)[0])


def _as_stored(config: StudyConfig, name: str, value: Any) -> Any:
    """Return a factor's value as a study stores it: `records = 6` is "6 drawn"."""
    try:
        return config.world.factors[name].read(value, name)
    except (KeyError, ValueError):  # position, repeat; or no run can have it
        return value


def _same(given: Any, value: Any) -> bool:
    """Return whether a value is the one given, floats to 1 % (0.0316 is 10^-1.5)."""
    if isinstance(value, int | str) or value is None or isinstance(given, bool | str):
        return given == value and isinstance(given, bool) == isinstance(value, bool)
    return bool(np.isclose(given, value, rtol=0.01, atol=0))


def trace_of(
    world: World,
    records: Records,
    params: Params,
    worlds: VectorEnv,
    how: Options,
    seed: int,
    options: dict[str, np.ndarray],
    controller: MakeController = FilterController,
) -> Trace:
    """Run one replay and record it.

    Arguments are as of :func:`jaxreplay.replay`; `how` is its reading of a jump, start and end.
    The beliefs are those that the filter has of the observations, also where another controller
    made them.
    """
    env = _Recorder(worlds, world.look)
    replays = replay(
        records, params, env, [seed], **how._asdict(), options=options, controller=controller
    )
    observations, commands, seen = zip(*env.rows, strict=True)
    one = jax.tree.map(lambda x: x[0], params)
    return Trace(
        observations=np.array(observations),
        commands=np.array(commands),
        beliefs=beliefs(records, one, how, np.array(observations)),
        records=records,
        ending=world.ending(replays),
        period=getattr(worlds.unwrapped, "control_period", records.period),
        scene=world.scene(seen),
    )


def beliefs(records: Records, params: Params, how: Options, observations: np.ndarray) -> np.ndarray:
    """Return p(I, τ | Z_1:t) of every step of a replay, `[T, N, L]`.

    All moments τ (positions on a record) are stored, without a window.
    """
    filter, centred = build_filter(how.jump), records.centred()

    def step(belief, z):
        belief, _ = filter.update(centred, params, filter.predict(centred, params, belief), z)
        return belief, filter.posterior(centred, belief)

    z = jnp.asarray(records.centre(observations))
    return np.asarray(jax.jit(lambda: jax.lax.scan(step, filter.init(centred, how.start), z)[1])())


class _Recorder(VectorWrapper):
    """Records the observation, the command and what is to be seen in the first world."""

    def __init__(self, env: VectorEnv, look: Callable[[VectorEnv], Any]):
        super().__init__(env)
        self.rows: list[tuple] = []
        self._look = look

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        """Simulate one control step and record it."""
        result = self.env.step(actions)
        self.rows.append((result[0][0].copy(), actions[0].copy(), self._look(self.env)))
        return result
