"""`reference` and `filter` behind one interface, for tests of both: plain probabilities.

A `case` has sensors, commands, z, theta_i, theta_tau and sigma; p is an (N, L) array, 0 past a
record's end.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.filter.numerics.scaled import Scaled, scaled
from jaxreplay.filter.observation import likelihood, log_density
from jaxreplay.filter.transition import record_transition, time_transition


class InNumPy:
    """`reference` with probabilities instead of their logarithms."""

    tolerance = 1e-9

    def likelihood(self, case):
        return np.exp(reference.likelihood(case.sensors, self._params(case), case.z))

    def record_transition(self, case, p):
        return np.exp(reference.record_transition(self._params(case), self._log(p)))

    def time_transition(self, case, p):
        return np.exp(reference.time_transition(case.sensors, self._params(case), self._log(p)))

    def init(self, case, jump):
        return np.exp(reference.init(case.sensors))

    def predict(self, case, p, jump):
        log_p = reference.predict(case.sensors, self._params(case), self._log(p), jump)
        return np.exp(log_p)

    def command(self, case, commands, p):
        return reference.command(commands, self._log(p))

    def update(self, case, p):
        params = self._params(case)
        log_p, log_evidence = reference.update(case.sensors, params, self._log(p), case.z)
        return np.exp(log_p), log_evidence

    def end_probability(self, case, p):
        return reference.end_probability(case.sensors, self._log(p))

    def _params(self, case):
        return reference.Params(case.theta_i, case.theta_tau, np.array(case.sigma))

    def _log(self, p):
        with np.errstate(divide="ignore"):
            return np.log(p)


class InJax:
    """`filter`: NumPy arrays of float64 in, arrays of its own precision out."""

    def __init__(self, precision, jit=True):
        self.precision, self.jit = precision, jit
        self.tolerance = {"float32": 2e-5, "float64": 1e-9}[precision]

    def likelihood(self, case):
        records, params = self._records(case), self._params(case)
        z, anchor = (jnp.asarray(records.centre(x)) for x in (case.z, case.sensors[0][0]))
        logs = _log_likelihood(records.centred(), params, z, anchor)
        assert logs.dtype == self.precision
        p = np.exp(np.asarray(logs, float))
        return np.where(np.arange(p.shape[1]) < np.array(records.lengths)[:, None], p, 0.0)

    def record_transition(self, case, p):
        return _value(_record_transition(self._params(case), self._scaled(p)))

    def time_transition(self, case, p):
        records, params = self._records(case), self._params(case)
        return _value(_time_transition(records, params, self._scaled(p)))

    def init(self, case, jump):
        return _value(build_filter(jump).init(self._records(case)).p)

    def predict(self, case, p, jump):
        records, belief = self._records(case), self._belief(case, p, jump)
        return _value(build_filter(jump).predict(records, self._params(case), belief).p)

    def command(self, case, commands, p):
        records = Records.from_sequences(case.sensors, commands)
        return build_filter().command(records, self._belief(case, p))

    def update(self, case, p):
        records, belief = self._records(case), self._belief(case, p)
        after, log_evidence = build_filter().update(records, self._params(case), belief, case.z)
        return _value(after.p), log_evidence

    def end_probability(self, case, p):
        return build_filter().end_probability(self._records(case), self._belief(case, p))

    def _records(self, case):
        return Records.from_sequences(case.sensors, case.commands)

    def _params(self, case):
        return Params(case.theta_i, case.theta_tau, np.array(case.sigma))

    def _scaled(self, p):
        return _scaled(jnp.asarray(p, self.precision))

    def _belief(self, case, p, jump="own_tau"):
        return dataclasses.replace(build_filter(jump).init(self._records(case)), p=self._scaled(p))


@jax.jit
def _log_likelihood(records, params, z, anchor):
    return likelihood(records, params, z, anchor) + log_density(params, z, anchor)


_record_transition, _time_transition = jax.jit(record_transition), jax.jit(time_transition)
_scaled, _value = jax.jit(scaled), jax.jit(Scaled.value)
