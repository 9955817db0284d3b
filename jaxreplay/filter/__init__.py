"""The Bayesian filter of section 2: the equations of :mod:`jaxreplay.reference`, in JAX.

| paper | function |
| --- | --- |
| equation 2, observation model | `observation.likelihood` |
| equation 3, transition between records | `transition.record_transition` |
| equation 4, transition along a record | `transition.time_transition` |
| equation 5, initial condition | `steps.init` |
| equation 6, prediction | `transition.predict_same_tau`, `transition.predict_own_tau` |
| equations 7 and 8, command | `steps.command` |
| equation 9, update (6 and 9 together are the recursion of 1) | `steps.update` |
| § 2.2.5, termination | `steps.end_probability` |

Arguments come in one order: records, params, belief, observation z.
"""

from collections.abc import Callable
from functools import cache, partial, wraps
from typing import NamedTuple

import jax

from jaxreplay.filter.belief import DEFAULT_JUMP, Belief, Jump
from jaxreplay.filter.belief import READINGS as READINGS
from jaxreplay.filter.options import options_of
from jaxreplay.filter.steps import (
    command,
    end_probability,
    init,
    posterior,
    predict,
    update,
)
from jaxreplay.filter.window import NARROWEST
from jaxreplay.params import Params
from jaxreplay.records import Records


class Filter(NamedTuple):
    """The jitted steps that :func:`build_filter` returns; see :mod:`jaxreplay.filter.steps`."""

    init: Callable[..., Belief]
    predict: Callable[[Records, Params, Belief], Belief]
    command: Callable[[Records, Belief], jax.Array]
    update: Callable[[Records, Params, Belief, jax.Array], tuple[Belief, jax.Array]]
    posterior: Callable[[Records, Belief], jax.Array]
    end_probability: Callable[..., jax.Array]


@cache
def build_filter(jump: Jump = DEFAULT_JUMP, window: int | None = None) -> Filter:
    """Return the filter for one reading of a jump.

    Args:
        jump: `"same_tau"`, equation 6 as printed, or `"own_tau"`, in which each record keeps its
            own distribution over τ (see :mod:`jaxreplay.filter.transition`).
        window: samples of each record to store, in a window that travels with the belief (see
            :mod:`jaxreplay.filter.window`). Probability outside it is lost; `Belief.dropped` tells
            how probable the most probable lost hypothesis was. None stores all samples.

    Raises:
        ValueError: `jump` is not one of `READINGS`, or the window is too narrow. `predict`
            and `update` raise it for a belief of another filter.
    """
    options_of(jump)
    if window is not None and window < NARROWEST:
        raise ValueError(f"window must be None or at least {NARROWEST} samples; got {window}")
    jitted_init = jax.jit(partial(init, jump=jump, window=window), static_argnames="start")
    jitted = jax.jit(update)

    def init_anywhere_or_first(records, start="first"):
        options_of(jump, start)
        return jitted_init(records.centred(), start=start)

    def update_raw(records, params, belief, z):
        _check_belief(records, belief, jump, window)
        records.check_one_each(z=z, sigma=params.sigma)  # here, where sensors have names
        # Centred here: `jit` would round a NumPy array before its offset is subtracted.
        z = records.centre(z)
        records.check_finite("z", z)
        return jitted(records.centred(), params, belief, z)

    jitted_predict = _nameless(predict)

    def predict_own(records, params, belief):
        _check_belief(records, belief, jump, window)
        return jitted_predict(records, params, belief)

    return Filter(
        init=init_anywhere_or_first,
        predict=predict_own,
        command=_nameless(command),
        update=update_raw,
        posterior=_nameless(posterior),
        end_probability=_nameless(end_probability),
    )


def _nameless(step: Callable) -> Callable:
    """Jit a step so that it is compiled once for records that differ in their names alone."""
    jitted = jax.jit(step)

    @wraps(step)
    def call(records, *args, **more):
        return jitted(records.centred(), *args, **more)

    return call


def _check_belief(records: Records, belief: Belief, jump: Jump, window: int | None) -> None:
    """Check that a belief is of this filter: of its reading of a jump and of its window."""
    if window is not None and window >= records.longest:
        window = None
    if (belief.jump, belief.window) != (jump, window):
        raise ValueError(
            f"the belief is of build_filter({belief.jump!r}, {belief.window}); this filter is "
            f"build_filter({jump!r}, {window})"
        )
