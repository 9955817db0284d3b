"""Hypotheses too improbable for a float, and observations far from all records."""

from functools import partial

import jax
import numpy as np
import pytest
from filter_helpers import (
    both_precisions,
    both_readings,
    noise,
    own_tau_first,
    run,
    run_reference,
    x64,
)
from random_helpers import N_SENSORS, random_sequences

from jaxreplay import Params, Records, build_filter

SIGMA = np.array([0.5, 2.0])


def plateaus(*levels):
    """Records that stay at one value of all sensors, the first the longest."""
    sensors = [np.full((200, N_SENSORS), level) * SIGMA for level in levels]
    return sensors, random_sequences()[1][:1] * len(levels)


@both_readings
def test_a_record_far_behind_wins_again_when_observations_match_it(jump):
    sequences = plateaus(0.0, 5.0, 40.0, 60.0)
    zs = np.repeat([0.0, 5.0], [220, 260], axis=0)[:, None] * SIGMA
    params = Params(0.0, 0.05, SIGMA)
    (posterior, _, log_evidence, _), _ = run(build_filter(jump), sequences, zs, params)
    want = run_reference(sequences, zs, 0.0, np.float32(0.05), SIGMA, jump)
    weights = posterior.sum(2)
    assert weights[219, 1] == 0  # e^-8250: below the smallest float
    assert weights[430, 0] > 0.999
    assert weights[-1, 1] > 0.999
    np.testing.assert_allclose(weights, want[0].sum(2), atol=2e-3)
    np.testing.assert_allclose(log_evidence, want[2], rtol=1e-4, atol=1e-4)


@both_readings
def test_a_moment_200_steps_behind_wins_again_when_observations_match_it(jump):
    sensors, commands = plateaus(0.0, 0.0, 0.0, 0.0)
    sensors[1][5] = 100 * SIGMA
    zs = np.zeros((222, N_SENSORS))
    zs[220] = 100 * SIGMA
    sequences = (sensors, commands)
    params = Params(0.0, 0.05, SIGMA)
    (posterior, *_), _ = run(build_filter(jump), sequences, zs, params)
    want = run_reference(sequences, zs, 0.0, np.float32(0.05), SIGMA, jump)
    assert posterior[219, 1, :6].max() < 1e-38  # 0.05^220 or so
    assert posterior[220, 1, 5] > 0.9
    np.testing.assert_allclose(posterior, want[0], atol=2e-5)


@both_readings
@both_precisions
@pytest.mark.parametrize("away", [1e3, 1e6, 1e12])
@pytest.mark.parametrize("side", [-1, 1])
def test_far_observations_choose_the_nearest_record(jump, precision, away, side):
    sensors, commands = plateaus(0.0, 1.0, -1.0, 0.5)
    sensors = [s + 0.1 * SIGMA * noise(i, *s.shape) for i, s in enumerate(sensors)]
    zs = side * away * np.ones((3, 1)) * SIGMA
    with x64(precision):
        f, params = build_filter(jump), Params(0.1, 0.05, SIGMA)
        (posterior, u, log_evidence, _), belief = run(f, (sensors, commands), zs, params)
        assert all(
            np.isfinite(x).all() for x in (posterior, u, log_evidence, *jax.tree.leaves(belief.p))
        )
    assert (posterior.sum(2).argmax(1) == (1 if side > 0 else 2)).all()
    np.testing.assert_allclose(posterior.sum((1, 2)), 1, atol=1e-6)


@both_readings
@pytest.mark.parametrize(
    ("jumps", "away"),
    [(1e6, 0.0), (0.5, 1.6e5)],
    ids=["records jump by a million σ", "a step of half a σ, far away"],
)
def test_eight_sensors_at_once_do_not_underflow(jump, jumps, away):
    """The mean along each segment is 10⁻⁵ of its peak or less: 10⁻⁴⁰ for eight, no float32."""
    rows = [level + jumps * np.tile(np.arange(30)[:, None] % 2, 8) for level in (0.0, 3.0)]
    commands = [np.full((30, 1), float(i)) for i in range(2)]
    zs = np.full((4, 8), away)
    params = Params(0.1, 0.05, np.ones(8))
    (posterior, *_), belief = run(build_filter(jump), (rows, commands), zs, params)
    assert np.isfinite(belief.p.mantissa).all()
    nearer = 1 if away else 0  # from far above, the higher record
    assert (posterior.sum(2)[:, nearer] > 0.99).all()


@own_tau_first
@pytest.mark.parametrize(
    ("n", "batch", "largest"), [(30, 4, 18), pytest.param(300, 300, 9, marks=pytest.mark.slow)]
)
def test_posteriors_sum_to_1_however_far_everything_is(jump, n, batch, largest):
    """Records that reach 10^21 σ, and observations up to 10^4 times beyond them.

    The slow form is of a million observations, half of them for each reading.
    """
    rng, filter = np.random.default_rng(n), build_filter(jump)

    @jax.jit
    @partial(jax.vmap, in_axes=(None, 0, 0))
    def sums(records, params, zs):
        def step(belief, z):
            belief, evidence = filter.update(
                records, params, filter.predict(records, params, belief), z
            )
            return belief, (filter.posterior(records, belief).sum(), evidence)

        return jax.lax.scan(step, filter.init(records), zs)[1]

    for _ in range(n):
        scale = 10.0 ** rng.uniform(-3, largest, N_SENSORS)
        rows = [rng.normal(size=(12, N_SENSORS)) * scale for _ in range(4)]
        records = Records.from_sequences(rows, [np.zeros((12, 1))] * 4).centred()
        theta_i, theta_tau = rng.uniform(0, 1, batch), rng.uniform(0, 0.5, batch)
        params = Params(theta_i, theta_tau, 10.0 ** rng.uniform(-3, 2, (batch, N_SENSORS)))
        factor = scale * 10.0 ** rng.uniform(-2, 4, (batch, 6, 1))
        zs = rng.normal(size=(batch, 6, N_SENSORS)) * factor
        total, evidence = sums(records, params, np.asarray(zs, records.nodes.dtype))
        np.testing.assert_allclose(total, 1, atol=1e-5)
        assert np.isfinite(evidence).all()
