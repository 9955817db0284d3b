"""One run of a study done again, and recorded step by step."""

from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from gymnasium.vector import VectorEnv, VectorWrapper

from jaxreplay.errors import ConfigError
from jaxreplay.filter import build_filter
from jaxreplay.filter.belief import Belief, Jump
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


class Step(NamedTuple):
    """One control step of a run.

    Attributes:
        observation: `[n_s]`.
        command: `[n_u]`.
        belief: `[N, L]` p(I, τ | Z_1:t).
        seen: what was to be seen in the world, see `World.look`.
    """

    observation: np.ndarray
    command: np.ndarray
    belief: np.ndarray
    seen: Any


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
    if isinstance(study, Path):
        records = taught_in(study, config)
    else:
        records = demonstrations(config, folder)
    return k, run_again(config, records, k)


def taught_in(folder: Path, config: StudyConfig) -> Demonstrations:
    """Return the records with which the study in a folder was run.

    Raises:
        ConfigError: they have changed since.
    """
    records = demonstrations(config, folder)
    if content_of(records) != read_manifest(folder)["demonstrations"]:
        raise ConfigError(
            f"the demonstrations of {folder} are not those with which it was run: put the file "
            "back as it was"
        )
    return records


def run_again(
    config: StudyConfig,
    demonstrations: Demonstrations,
    k: int,
    follow: Callable[[Records, Step], None] = lambda records, step: None,
) -> Trace:
    """Do the k-th run of a study again and record it.

    Args:
        config: the study.
        demonstrations: its records.
        k: the run's index, counted along the dataset's dimensions.
        follow: called after each control step, with the records that are replayed.

    Returns:
        The run. With the same records, results format and kind of processor it is identical to
        the study's run, bit for bit.
    """
    one, factors = runs_of(config).of(np.array([k])), config.world.factors
    params, (seed,), options = settings_of(config, demonstrations, one)
    how, chosen = how_of(one), records_of(config, demonstrations, one)
    controller = controller_named(one.values["controller"][0])
    with closing(worlds_of(config, one, render=True)) as worlds, config.world.failures():
        trace = trace_of(
            config.world, chosen, params, worlds, how, seed, options, controller, follow
        )
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
    follow: Callable[[Records, Step], None] = lambda records, step: None,
) -> Trace:
    """Run one replay and record it.

    Arguments are as of :func:`jaxreplay.replay` and :func:`run_again`; `how` is the reading of a
    jump, start and end. The beliefs are those that the filter has of the observations, also where
    another controller made them.
    """
    one = jax.tree.map(lambda x: x[0], params)
    env = _Recorder(
        worlds, world.look, Beliefs(records, one, how), lambda step: follow(records, step)
    )
    replays = replay(
        records, params, env, [seed], **how._asdict(), options=options, controller=controller
    )
    observations, commands, found, seen = zip(*env.steps, strict=True)
    return Trace(
        observations=np.array(observations),
        commands=np.array(commands),
        beliefs=np.array(found),
        records=records,
        ending=world.ending(replays),
        period=getattr(worlds.unwrapped, "control_period", records.period),
        scene=world.scene(seen),
    )


class Beliefs:
    """The belief of one replay, step by step, over all moments τ, without a window."""

    def __init__(self, records: Records, params: Params, how: Options):
        """Begin at the records' first samples, or wherever `how` starts."""
        self._records, self._params, self._jump = records.centred(), params, how.jump
        self._centre = records.centre
        self._belief = build_filter(how.jump).init(self._records, how.start)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Take in an observation `[n_s]`, and return p(I, τ | Z_1:t), `[N, L]`."""
        seen = jnp.asarray(self._centre(z))
        self._belief, p = _next(self._records, self._params, self._belief, seen, self._jump)
        return np.asarray(p)


@partial(jax.jit, static_argnames="jump")
def _next(records: Records, params: Params, belief: Belief, z: jax.Array, jump: Jump):
    filter = build_filter(jump)
    belief, _ = filter.update(records, params, filter.predict(records, params, belief), z)
    return belief, filter.posterior(records, belief)


class _Recorder(VectorWrapper):
    """Records each step of the first world: observation, command, belief and what is to be seen."""

    def __init__(
        self,
        env: VectorEnv,
        look: Callable[[VectorEnv], Any],
        belief_of: Callable[[np.ndarray], np.ndarray],
        follow: Callable[[Step], None],
    ):
        super().__init__(env)
        self.steps: list[Step] = []
        self._look, self._belief_of, self._follow = look, belief_of, follow

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        """Simulate one control step and record it."""
        result = self.env.step(actions)
        z = result[0][0].copy()
        self.steps.append(Step(z, actions[0].copy(), self._belief_of(z), self._look(self.env)))
        self._follow(self.steps[-1])
        return result
