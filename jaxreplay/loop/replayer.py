"""One robot, live: NumPy arrays in and out, everything compiled before the first command."""

import warnings
from threading import RLock
from typing import NamedTuple

import jax
import numpy as np

from jaxreplay.filter.belief import DEFAULT_JUMP, Jump
from jaxreplay.filter.options import LAST_STEPS, Start, options_of
from jaxreplay.loop.checks import check_end, check_types
from jaxreplay.loop.tracker import Tracker
from jaxreplay.params import Params
from jaxreplay.records import Records

_THIS = np.array([True])
COARSE = 1e3  # σ from the records' offset (mostly 0), where float32 resolves 1e-4 σ


class Followed(NamedTuple):
    """The most probable state.

    Attributes:
        record: index of the record, from 0.
        moment: τ, index of the sample in it, from 0.
        probability: p(I, τ) of that state.
        distance: in σ, from the last observation to the sample that was then followed, largest over
            sensors; 0 before the first. Values that stay above 3 mean that the robot is lost.
    """

    record: int
    moment: int
    probability: float
    distance: float


class Replayer:
    """Replays demonstrations on one robot: `command()`, act, `observe(z)`, and again.

    Everything it needs is compiled when it is made, which takes seconds. Beliefs are stored in
    windows that widen when they must (see :class:`jaxreplay.loop.tracker.Tracker`).

        replayer = Replayer(records, params)
        while replayer.end_probability <= 0.9:
            robot.send(replayer.command())
            replayer.observe(robot.sense())

    Threads may share it: a call waits until another has ended. Commands and observations must still
    alternate.

    Attributes:
        end_probability: p(τ in the last 10 samples, or `last_steps`) after the last observation
            (§ 2.2.5).
        log_evidence: log p(Z_1:t) since the start.
    """

    def __init__(
        self,
        records: Records,
        params: Params,
        jump: Jump = DEFAULT_JUMP,
        *,
        start: Start = "first",
        last_steps: int | None = LAST_STEPS,
        period: float | None = None,
    ):
        """Compile, and start.

        Args:
            records: N records.
            params: one set of parameters.
            jump: `"same_tau"` or `"own_tau"`.
            start: `"first"`, at the records' first samples (equation 5), or `"anywhere"` in them.
            last_steps: samples at a record's end that count as its end; 10 in the paper. 1: the
                last sample alone. None: as 1; for robots whose task ends otherwise.
            period: s between the robot's commands. Where the records' period is another, they are
                resampled (see :meth:`jaxreplay.Records.resampled`). None: the records'.

        Raises:
            ValueError: an option has no such value, parameters do not fit the records, or a period
                is given and that of the records is unknown.
        """
        options = options_of(jump, start, last_steps)
        check_fit(records, params)
        if period is not None:
            records = records.resampled(period)
        check_end(records, last_steps)
        self._records, self._lock = records, RLock()
        self._tracker = Tracker(records, jax.tree.map(lambda x: x[None], params), options)
        self._tracker.compile()
        self.reset()

    def reset(self, start: Start | None = None) -> None:
        """Start again.

        Args:
            start: `"first"` or `"anywhere"`, from now on; None: as before.

        Raises:
            ValueError: there is no such start.
        """
        if start is not None:
            self._tracker.start_from(options_of("own_tau", start).start)
        with self._lock:
            self._tracker.begin(_THIS, self._tracker.params)
            self._observed = True
            self.end_probability = self.log_evidence = self._distance = 0.0

    def command(self) -> np.ndarray:
        """Return the command `[n_u]` for the next control step, in the actuators' units.

        It is equation 8, within the range that each command has in the records.
        Called again without an observation between, it continues by time alone.
        """
        with self._lock:
            if not self._observed:
                self.observe(np.full(self._records.n_sensors, np.nan))
            self._observed = False
            return self._tracker.command[0].copy()

    def observe(self, z: np.ndarray) -> float:
        """Update the belief with the observation made after the command.

        Args:
            z: `[n_s]` Z_t in the sensors' units; NaN marks a missing sensor.

        Returns:
            log p(Z_t | Z_{1:t−1}).

        Raises:
            ValueError: another shape, a value that is infinite or too large for the working
                precision, or no command since the last observation. The belief is left unchanged.
        """
        names = self._records.sensor_names
        try:
            z = np.asarray(z, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"the observation is not an array of numbers: {z!r}") from None
        if z.shape != (len(names),):
            raise ValueError(
                f"the observation has shape {z.shape}; ({len(names)},) is needed, "
                f"a value for each of {', '.join(names)}"
            )
        # Centred, as that is where float32 may make a large value infinite.
        infinite = np.flatnonzero(np.isinf(np.asarray(self._records.centre(z))))
        if len(infinite):
            k = infinite[0]
            why = "; give NaN for a missing sensor"
            if np.isfinite(z[k]):
                why = (
                    f", too large for {self._records.nodes.dtype}; give NaN if it is no measurement"
                )
            raise ValueError(f"the observation's {names[k]} is {z[k]}{why}")
        with self._lock:
            if self._observed:
                raise ValueError("no command since the last observation: call command() first")
            log_evidence, end_probability, distance = self._tracker.observe(z[None], _THIS)
            self._observed = True
            self.log_evidence += float(log_evidence[0])
            self.end_probability, self._distance = float(end_probability[0]), float(distance[0])
            return float(log_evidence[0])

    @property
    def following(self) -> Followed:
        """The most probable record and sample for the next command (or the one just returned)."""
        with self._lock:
            belief = jax.tree.map(np.asarray, self._tracker.belief(0))
        p = belief.p.value()
        record, column = np.unravel_index(np.argmax(p), p.shape)
        start = np.broadcast_to(belief.start, len(p))[record]
        return Followed(int(record), int(start + column), float(p[record, column]), self._distance)


def check_fit(records: Records, params: Params) -> None:
    """Check that parameters fit records; warn where float32 resolves a sensor coarsely.

    Raises:
        ValueError: not one set of parameters, or not one σ per sensor.
    """
    check_types(records, params)
    sigma = np.asarray(params.sigma)
    if np.ndim(params.theta_i) or np.ndim(params.theta_tau) or sigma.shape != (records.n_sensors,):
        raise ValueError(
            f"one θ_I, one θ_τ and {records.n_sensors} values of σ are needed "
            f"({', '.join(records.sensor_names)}); got shapes {np.shape(params.theta_i)}, "
            f"{np.shape(params.theta_tau)} and {sigma.shape}"
        )
    reach = np.abs(np.asarray(records.nodes)).max(axis=(1, 2)) / sigma
    for name, far, offset in zip(records.sensor_names, reach, records.offset, strict=True):
        if records.nodes.dtype == np.float32 and far > COARSE:
            warnings.warn(
                f"{name} has values {far:.0f} σ from {offset:g}, where float32 is coarse; use "
                "JAX's x64, or a larger σ",
                stacklevel=3,
            )
