"""Is what a user gives to a closed loop usable? Checked before any work is done."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from jaxreplay.filter.options import LAST_STEPS
from jaxreplay.params import Params
from jaxreplay.records import Records


def check_types(records: Any, params: Any) -> None:
    """Check that these are `Records` and `Params`.

    Raises:
        ValueError: one is something else.
    """
    if not isinstance(records, Records):
        raise ValueError(
            f"records is a {type(records).__name__}; make them with jr.Records.from_sequences, "
            "from_steps or jr.read"
        )
    if not isinstance(params, Params):
        raise ValueError(f"params is a {type(params).__name__}; make them with jr.Params")


def check_end(records: Records, last_steps: int | None) -> None:
    """Check that not all of every record counts as its end.

    Raises:
        ValueError: it does, and by more than the paper's 10 samples.
    """
    if last_steps is not None and LAST_STEPS < last_steps >= records.longest:
        raise ValueError(
            f"last_steps is {last_steps}, but the longest record has {records.longest} rows: every "
            "replay would end at once; give fewer"
        )


def check_batch(
    records: Records, params: Params, n: int, options: Mapping[str, np.ndarray]
) -> None:
    """Check that parameters and options have a value for each of n replays.

    Raises:
        ValueError: one has not.
    """
    for name, value, wanted in (
        ("theta_i", params.theta_i, (n,)),
        ("theta_tau", params.theta_tau, (n,)),
        ("sigma", params.sigma, (n, records.n_sensors)),
    ):
        if np.shape(value) != wanted:
            raise ValueError(
                f"{name} has shape {np.shape(value)}; {n} seeds and {records.n_sensors} sensors "
                f"need {wanted}, a row for each replay"
            )
    for name, value in options.items():
        if np.shape(value)[:1] != (n,):
            raise ValueError(
                f"options[{name!r}] has shape {np.shape(value)}; a value for each of {n} seeds is "
                "needed"
            )


def check_environment(records: Records, env: VectorEnv) -> None:
    """Check that an environment can be driven with these records.

    Raises:
        ValueError: it is no vector environment, restarts by itself, or its spaces do not fit.
    """
    if not isinstance(env, VectorEnv):
        raise ValueError(
            "the environment is not a vector environment; make it with gymnasium.make_vec(id, n, "
            'vectorization_mode="sync", vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED})'
        )
    mode = env.metadata.get("autoreset_mode")
    if mode != AutoresetMode.DISABLED:
        raise ValueError(
            f"the environment's autoreset mode is {mode}; make it with AutoresetMode.DISABLED, so "
            "that a slot restarts when its replay has ended and not before"
        )
    for what, space, wanted in (
        ("observations", env.single_observation_space, records.n_sensors),
        ("actions", env.single_action_space, records.n_commands),
    ):
        if not isinstance(space, gymnasium.spaces.Box) or space.shape != (wanted,):
            flat = ""
            if isinstance(space, gymnasium.spaces.Dict | gymnasium.spaces.Tuple):
                flat = " (Gymnasium's wrapper FlattenObservation makes one)"
            raise ValueError(
                f"the environment's {what} are {space}; the records have {wanted} numbers a row, "
                f"so a Box of shape ({wanted},) is needed{flat}"
            )
