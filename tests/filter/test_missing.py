"""A NaN in an observation marks a missing sensor."""

import jax
import numpy as np
import pytest
from random_helpers import as_float32, random_sequences

from jaxreplay import Params, Records, build_filter, reference

SIGMA = np.array([0.5, 2.0])
PARAMS = reference.Params(theta_i=0.125, theta_tau=0.0625, sigma=SIGMA)


@pytest.mark.parametrize("jump", ["same_tau", "own_tau"])
def test_missing_sensors_as_in_the_reference(jump):
    sensors, commands = random_sequences(8)
    records = Records.from_sequences(sensors, commands)
    params = Params(*PARAMS)
    filter = build_filter(jump)
    belief, expected = filter.init(records), reference.init(sensors)
    rng = np.random.default_rng(0)
    for t in range(20):
        z = as_float32(sensors[0][t] + SIGMA * rng.normal(size=2))
        z[rng.random(2) < 0.4] = np.nan
        belief = filter.predict(records, params, belief)
        expected = reference.predict(sensors, PARAMS, expected, jump)
        belief, evidence = filter.update(records, params, belief, z)
        expected, expected_evidence = reference.update(sensors, PARAMS, expected, z)
        np.testing.assert_allclose(filter.posterior(records, belief), np.exp(expected), atol=2e-5)
        assert evidence == pytest.approx(expected_evidence, abs=1e-5)


def test_an_observation_of_missing_sensors_changes_nothing_and_has_no_evidence():
    sensors, commands = random_sequences(8)
    records = Records.from_sequences(sensors, commands)
    params = Params(*PARAMS)
    filter = build_filter()
    predicted = filter.predict(records, params, filter.init(records))
    belief, evidence = filter.update(records, params, predicted, np.full(2, np.nan))
    assert evidence == 0
    np.testing.assert_allclose(belief.p.value(), predicted.p.value(), rtol=1e-6)


def test_gradients_are_finite_where_a_sensor_is_missing():
    sensors, commands = random_sequences(8)
    records = Records.from_sequences(sensors, commands)
    filter = build_filter()

    def evidence(sigma):
        params = Params(*PARAMS._replace(sigma=sigma))
        predicted = filter.predict(records, params, filter.init(records))
        return filter.update(records, params, predicted, np.array([np.nan, 1.0]))[1]

    gradient = jax.grad(evidence)(SIGMA.astype(np.float32))
    assert gradient[0] == 0
    assert np.isfinite(gradient[1])
    assert gradient[1] != 0
