"""Equation 2 agrees with the reference, for segments and distances of any size."""

import jax
import jax.numpy as jnp
import numpy as np
from filter_helpers import both_precisions, noise, x64
from hypothesis import given
from hypothesis import strategies as st
from random_helpers import N_SENSORS, as_float32, random_sequences
from scipy.stats import norm

from jaxreplay import Params, Records, reference
from jaxreplay.filter.numerics.blocks import BLOCK
from jaxreplay.filter.observation import likelihood, log_density

SIGMA = np.array([0.5, 2.0])
PARAMS = reference.Params(0.1, 0.05, SIGMA)

jitted_likelihood = jax.jit(likelihood)


@both_precisions
@given(
    seed=st.integers(0, 2**32 - 1),
    apart=st.sampled_from([0, 1e-30, 1e-7, 1e-4, 3e-3, 0.02, 0.1, 0.3, 1, 30]),
    away=st.sampled_from([0, 1e-3, 1, 5, 10]),
)
def test_likelihood_is_equation_2(precision, seed, apart, away):
    sensors, commands = random_sequences(seed, step=apart)
    z = as_float32(away * SIGMA * noise(seed, N_SENSORS))
    anchor = as_float32(z + 0.3 * SIGMA)
    with x64(precision):
        records = Records.from_sequences(sensors, commands)
        params = Params(*PARAMS)
        points = (jnp.asarray(x, precision) for x in (z, anchor))
        got = np.array(jitted_likelihood(records, params, *points), float)
    got += norm.logpdf(z, anchor, SIGMA).sum()
    tolerance = {"float32": 1e-5, "float64": 1e-12}[precision]
    want = reference.likelihood(sensors, PARAMS, z)
    stored = want > -np.inf
    assert stored.sum() == sum(map(len, sensors))
    np.testing.assert_allclose(got[stored], want[stored], rtol=tolerance, atol=tolerance)


def test_every_state_of_long_records_is_as_likely_as_in_the_reference():
    length = BLOCK  # three records in four blocks, and no block ends where a record does
    sensors = as_float32(np.sin(1e-3 * noise(3, 3, length, 2).cumsum(1)))
    thetas_and_sigma, z = (0.1, 0.05, np.float32([0.1, 0.3])), np.float32([0.2, -0.1])
    params = Params(*thetas_and_sigma)
    records = Records.from_sequences(list(sensors), [np.zeros((length, 1))] * 3)
    got = likelihood(records, params, z, z) + log_density(params, z, z)
    want = reference.likelihood(sensors, reference.Params(*thetas_and_sigma), z)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-4)
