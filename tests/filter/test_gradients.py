"""Gradients of the log evidence are its differences, computed from the reference."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_helpers import COMPILE_QUICKLY, own_tau_first, passing, run_reference, x64
from random_helpers import random_sequences

from jaxreplay import Params, Records, build_filter

SIGMA = np.array([0.5, 2.0])


@own_tau_first
def test_gradients_of_log_evidence_are_its_differences(jump):
    sequences = random_sequences(8)
    sequences[0][0][4] = sequences[0][0][3]  # a segment of no length
    sequences[0][1][5] = sequences[0][1][4] + 1e-4
    zs = passing(sequences[0][0], SIGMA, 10)
    zs[2] = sequences[0][0][3]  # an observation on a sample
    at = np.array([0.1, 0.05, *SIGMA])

    def by_reference(values):
        return run_reference(sequences, zs, *values[:2], values[2:], jump)[2].sum()

    nudges = 1e-6 * np.diag(at)
    want = [
        (by_reference(at + nudge) - by_reference(at - nudge)) / 2 / nudge.max() for nudge in nudges
    ]
    with x64():
        records, f = Records.from_sequences(*sequences), build_filter(jump)

        def total(params):
            def step(belief, z):
                return f.update(records, params, f.predict(records, params, belief), z)

            return jax.lax.scan(step, f.init(records), jnp.asarray(zs))[1].sum()

        both = jax.jit(jax.value_and_grad(total), compiler_options=COMPILE_QUICKLY)
        value, gradient = both(Params(*at[:2], at[2:]))
        got = [gradient.theta_i, gradient.theta_tau, *gradient.sigma]
    assert value == pytest.approx(by_reference(at), rel=1e-10)
    np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-6)
