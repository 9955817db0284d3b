"""Controllers: what turns observations into commands in a closed loop. The filter is one."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from jaxreplay.filter.options import Options
from jaxreplay.loop.tracker import LANES, Tracker
from jaxreplay.machine import cores
from jaxreplay.params import Params
from jaxreplay.records import Records


class Observed(NamedTuple):
    """What a controller returns for B observations; one value stands for all B.

    Attributes:
        end_probability: `[B]` how sure it is that the task is complete; above 0.9 the replay ends.
        log_evidence: `[B]` log p(Z_t | Z_{1:t−1}); NaN: it has none.
        widened: `[B]` as in :class:`jaxreplay.loop.tracker.Tracker`.
        dropped: `[B]` as in :class:`jaxreplay.loop.tracker.Tracker`.
        distance: `[B]` in σ, from the observation to the state followed; NaN: it follows none.
    """

    end_probability: np.ndarray | float
    log_evidence: np.ndarray | float = np.nan
    widened: np.ndarray | int = 0
    dropped: np.ndarray | float = -np.inf
    distance: np.ndarray | float = np.nan


class Controller(Protocol):
    """Controls B replays that advance together, each in a slot.

    It is made by `controller(records, params, options)`, see :data:`MakeController`. Results of a
    slot must not depend on the other slots.
    """

    @property
    def command(self) -> np.ndarray:
        """`[B, n_u]` the commands to send next."""
        ...

    def begin(self, which: np.ndarray, params: Params) -> None:
        """Begin new replays in the slots `which`, `[B]` bool, with `[B]`-batched parameters."""
        ...

    def observe(self, z: np.ndarray, which: np.ndarray) -> Observed:
        """Take in an observation each, `[B, n_s]`, in the slots `which`, `[B]` bool.

        NaN marks a missing sensor. What is returned for the other slots is ignored.
        """
        ...


# Called as (records, `[B]`-batched params, options).
MakeController = Callable[[Records, Params, Options], Controller]


class FilterController:
    """The filter: B slots tracked in threads, `LANES` of them in each.

    All have `LANES` lanes, so that the same compiled programs serve. The last may have lanes
    without a slot; these never observe.
    """

    def __init__(
        self,
        records: Records,
        params: Params,
        options: Options,
        tracker: Callable[[Records, Params, Options], Any] = Tracker,
    ):
        """Begin B replays.

        Args:
            records: N records.
            params: `[B]`-batched parameters.
            options: reading of a jump, start, and what counts as a record's end.
            tracker: constructor of the filter of `LANES` slots. Another than the default serves to
                compare filters.
        """
        self._slots = len(params.theta_i)
        self._parts = [slice(i, i + LANES) for i in range(0, self._slots, LANES)]
        self._lanes = self._parts[-1].stop
        padded = self._padded(params)
        self._each = [tracker(records, _part(padded, part), options) for part in self._parts]
        self._threads = ThreadPoolExecutor(min(cores(), len(self._parts)))

    def begin(self, which: np.ndarray, params: Params) -> None:
        """Begin new replays in the slots `which`."""
        which, params = self._padded(which), self._padded(params)
        for tracker, part in zip(self._each, self._parts, strict=True):
            if which[part].any():
                tracker.begin(which[part], _part(params, part))

    def observe(self, z: np.ndarray, which: np.ndarray) -> Observed:
        """Update the beliefs of the slots `which`, and predict."""
        z, which = self._padded(z), self._padded(which)
        results = np.zeros((3, self._lanes))

        def one(tracker: Any, part: slice) -> None:
            if which[part].any():
                results[:, part] = tracker.observe(z[part], which[part])

        list(self._threads.map(one, self._each, self._parts))
        log_evidence, end_probability, distance = results[:, : self._slots]
        widened = self._joined([tracker.widened for tracker in self._each])
        dropped = self._joined([tracker.dropped for tracker in self._each])
        return Observed(end_probability, log_evidence, widened, dropped, distance)

    @property
    def command(self) -> np.ndarray:
        """`[B, n_u]` the commands to send next."""
        return self._joined([tracker.command for tracker in self._each])

    def _joined(self, values: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(values)[: self._slots]

    def _padded(self, values: Any) -> Any:
        """Return arrays `[B, …]` with the last slot repeated for lanes without a slot."""
        last = np.minimum(np.arange(self._lanes), self._slots - 1)
        padded = jax.tree.map(lambda x: np.asarray(x)[last], values)
        if isinstance(values, np.ndarray) and values.dtype == bool:
            padded[self._slots :] = False
        return padded


def _part(params: Params, part: slice) -> Params:
    return jax.tree.map(lambda x: x[part], params)
