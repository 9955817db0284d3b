from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import LENGTHS, N_SENSORS, as_float32, random_sequences
from filter_helpers import (
    COMPILE_QUICKLY,
    PRECISIONS,
    READINGS,
    assert_agree,
    both_precisions,
    both_readings,
    noise,
    own_tau_first,
    run,
    run_reference,
    tolerance,
    x64,
)
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.observation import likelihood
from jaxreplay.scaled import scaled
from jaxreplay.transition import record_transition
from jaxreplay.window import NOTHING

SIGMA = np.array([0.5, 2.0])
STEPS = 30


def passing(record, seed=0):
    """Observations along a record, at its pace or so, the last sample seen until the end."""
    at = np.minimum(np.arange(STEPS), len(record) - 1)
    return record[at] + SIGMA * noise(seed, STEPS, N_SENSORS)


@cache
def scenario(name):
    """Sensors, commands and observations that float32 holds exactly."""
    sensors, commands = random_sequences(1)
    zs = passing(sensors[0])
    if name == "random, the longest last":
        sensors, commands = random_sequences(2, LENGTHS[::-1])
        zs = passing(sensors[2])
    elif name == "far":
        sides = np.sign(noise(1, STEPS, N_SENSORS))
        highest = np.max([s.max(0) for s in sensors], axis=0)
        lowest = np.min([s.min(0) for s in sensors], axis=0)
        reach = SIGMA * np.linspace(0, 10, STEPS)[:, None]
        zs = np.where(sides > 0, highest + reach, lowest - reach)
    elif name == "samples far apart":
        sensors, commands = random_sequences(3, step=30)
        zs = passing(sensors[0])
    elif name == "near duplicates":
        base, commands = random_sequences(4, (200, 200, 150, 35))
        sensors = [base[0][: len(s)] + 1e-3 * noise(i, *s.shape) for i, s in enumerate(base)]
        zs = passing(sensors[0])
    elif name == "samples nearly equal":
        _, commands = random_sequences(5, (200, 200, 200, 39))
        apart = [0, 1e-30, 1e-7, 1e-3]
        sensors = [
            SIGMA * d * noise(i, len(c), N_SENSORS).cumsum(0)
            for i, (d, c) in enumerate(zip(apart, commands, strict=True))
        ]
        sensors[2][::2] += SIGMA  # every other segment is long, the rest no longer than 1e-7 σ
        sensors[2][1::2] = sensors[2][::2]
        sensors[3] += 0.5
        zs = 2 * SIGMA * noise(6, STEPS, N_SENSORS)
    elif name == "all short":
        sensors, commands = random_sequences(6, (200, 1, 2, 1))
        sensors[0] += 20
        zs = passing(sensors[2])
    return [as_float32(s) for s in sensors], commands, as_float32(zs)


SCENARIOS = (
    "random",
    "random, the longest last",
    "far",
    "samples far apart",
    "near duplicates",
    "samples nearly equal",
    "all short",
)
THETAS = [
    (0, 0.05),
    (1e-30, 0.05),
    (0.1, 0.0),
    (0.1, 0.05),
    (0.1, 0.5),
    (1, 0.05),
    (0, 0),
    (1, 0.5),
]


@cache
def expected(name, theta_i, theta_tau, jump):
    *sequences, zs = scenario(name)
    thetas = as_float32([theta_i, theta_tau])
    return run_reference(sequences, zs, *thetas, SIGMA, jump)


@both_readings
@both_precisions
@pytest.mark.parametrize("thetas", THETAS[:4])
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_step_agrees_with_the_reference(name, thetas, precision, jump):
    check_every_step(name, thetas, precision, jump)


@both_readings
@both_precisions
@pytest.mark.parametrize("thetas", THETAS[4:])
@pytest.mark.parametrize("name", SCENARIOS[:2])
def test_every_step_agrees_with_the_reference_for_extreme_thetas(name, thetas, precision, jump):
    check_every_step(name, thetas, precision, jump)


def check_every_step(name, thetas, precision, jump):
    *sequences, zs = scenario(name)
    with x64(precision):
        params = Params(*as_float32(thetas), SIGMA)
        got, _ = run(build_filter(jump), sequences, zs, params)
    assert got[0].dtype == precision
    allowed = tolerance(sequences[0], zs, SIGMA, precision)
    assert_agree(got, expected(name, *thetas, jump), allowed, precision)


@pytest.mark.parametrize(("jump", "precision"), list(zip(READINGS, PRECISIONS, strict=True)))
def test_one_record_agrees_with_the_reference(jump, precision):
    sequences = random_sequences(7, (200,))
    zs = as_float32(passing(sequences[0][0]))
    with x64(precision):
        got, _ = run(build_filter(jump), sequences, zs, Params(0.5, 0.125, SIGMA))
    want = run_reference(sequences, zs, 0.5, 0.125, SIGMA, jump)
    assert_agree(got, want, tolerance(sequences[0], zs, SIGMA, precision), precision)


def test_one_record_has_nowhere_to_jump():
    mass = scaled(jnp.array([[0.25, 0.5, 1e-30]]))
    after = record_transition(jnp.float32(0.7), mass)
    np.testing.assert_array_equal(after.value(), mass.value())


def one_step(f, records, params, belief, z):
    belief = f.predict(records, params, belief)
    u = f.command(records, belief)
    belief, log_evidence = f.update(records, params, belief, z)
    return belief, (f.posterior(records, belief), u, log_evidence)


@cache
def batched_step(jump):
    """A step jitted and vmapped over params, belief and z, and the list of its compilations."""
    f, compilations = build_filter(jump), []

    def step(*replays):
        compilations.append(1)
        return jax.vmap(partial(one_step, f), in_axes=(None, 0, 0, 0))(*replays)

    return jax.jit(step), compilations


def assert_close(got, want):
    for a, b in zip(got, want, strict=True):
        np.testing.assert_allclose(a, b, atol=2e-6, rtol=1e-5)


@both_readings
def test_a_batch_of_replays_is_the_same_as_each_alone(jump):
    *sequences, zs = scenario("random")
    records, f = Records.from_sequences(*sequences), build_filter(jump)
    batch = Params([0.0, 0.1, 1.0], [0.05, 0.0, 0.5], np.outer([0.5, 1, 2], SIGMA))
    rows = [Params(*values) for values in zip(*jax.tree.leaves(batch), strict=True)]
    alone = [f.init(records)] * 3
    together = jax.tree.map(lambda *beliefs: jnp.stack(beliefs), *alone)
    for z in zs[:9].reshape(3, 3, N_SENSORS):
        together, got = batched_step(jump)[0](records, batch, together, z)
        pairs = [one_step(f, records, *replay) for replay in zip(rows, alone, z, strict=True)]
        alone = [belief for belief, _ in pairs]
        want = zip(*(seen for _, seen in pairs), strict=True)
        assert_close(got, [np.stack(values) for values in want])


@pytest.mark.slow
@both_readings
def test_steps_are_the_same_without_jit(jump):
    *sequences, zs = scenario("random")
    records, f = Records.from_sequences(*sequences), build_filter(jump)
    params = Params(0.1, 0.05, SIGMA)
    jitted = belief = f.init(records)
    for z in zs[:1]:
        jitted, want = one_step(f, records, params, jitted, z)
        with jax.disable_jit():
            belief, got = one_step(f, records, params, belief, z)
        assert_close(got, want)


@both_readings
def test_new_values_compile_nothing_new(jump):
    f, (step, compilations) = build_filter(jump), batched_step(jump)
    for seed, theta in enumerate([0.1, 0, np.float64(0.5)]):
        records = Records.from_sequences(*random_sequences(seed, (200, 1 + seed, 7, 200)))
        params = Params([theta] * 3, [theta / 2] * 3, np.full((3, N_SENSORS), 1 + seed))
        belief = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), f.init(records))
        for z in (jnp.ones((3, N_SENSORS)), seed * np.ones((3, N_SENSORS))):
            belief, _ = step(records, params, belief, z)
    assert len(compilations) == 1


@both_readings
def test_belief_starts_at_the_first_sample_of_every_record(jump):
    records, f = Records.from_sequences(*random_sequences()), build_filter(jump)
    belief = f.init(records)
    np.testing.assert_array_equal(f.posterior(records, belief), 0.25 * np.eye(1, 200).repeat(4, 0))
    assert belief.dropped == NOTHING


def test_jumps_that_all_land_past_the_end_keep_the_belief():
    records, f = Records.from_sequences(*random_sequences()), build_filter("same_tau")
    p = np.zeros((4, 200), np.float32)
    p[0, [33, 36]] = 0.25, 0.75  # the other records have 31, 2 and 1 samples
    belief = f.init(records)._replace(p=scaled(jnp.asarray(p)))
    after = f.predict(records, Params(1, 0.05, SIGMA), belief)
    np.testing.assert_array_equal(f.posterior(records, after), p)


def test_end_probability_counts_the_last_ten_moments_and_short_records_whole():
    records, f = Records.from_sequences(*random_sequences()), build_filter("same_tau")
    counted = np.zeros((4, 200), bool)
    counted[0, 190:] = counted[1, 21:31] = counted[2, :2] = counted[3, 0] = True
    for i, j in [(0, 189), (0, 190), (0, 199), (1, 20), (1, 21), (1, 30), (2, 0), (2, 1), (3, 0)]:
        p = np.zeros((4, 200), np.float32)
        p[i, j] = 1
        belief = f.init(records)._replace(p=scaled(jnp.asarray(p)))
        assert f.end_probability(records, belief) == counted[i, j], (i, j)


@both_readings
@given(
    seed=st.integers(0, 2**32 - 1),
    theta_i=st.floats(0, 1),
    theta_tau=st.floats(0, 0.5),
    scale=st.sampled_from([1e-3, 0.1, 1, 30]),
    away=st.sampled_from([0, 3, 30, 1e4]),
)
def test_distributions_sum_to_1(jump, seed, theta_i, theta_tau, scale, away):
    sequences, f = random_sequences(seed, step=scale), build_filter(jump)
    records = Records.from_sequences(*sequences)
    params = Params(theta_i, theta_tau, SIGMA)
    padding = np.arange(200) >= np.array(LENGTHS)[:, None]
    belief = f.init(records)
    for z in away * SIGMA * noise(seed, 4, N_SENSORS):
        belief = f.predict(records, params, belief)
        after, log_evidence = f.update(records, params, belief, z)
        for p in (f.posterior(records, belief), f.posterior(records, after)):
            assert np.sum(p) == pytest.approx(1, abs=1e-5)
            assert np.min(p) >= 0
            assert not np.any(np.asarray(p)[padding])
        assert np.isfinite(log_evidence)
        belief = after


@both_precisions
@given(
    seed=st.integers(0, 2**32 - 1),
    apart=st.sampled_from([0, 1e-30, 1e-7, 1e-4, 3e-3, 0.02, 0.1, 0.3, 1, 30]),
    away=st.sampled_from([0, 1e-3, 1, 5, 10]),
)
def test_likelihood_is_equation_2(precision, seed, apart, away):
    sensors, commands = random_sequences(seed, step=apart)
    z = as_float32(away * SIGMA * noise(seed, N_SENSORS))
    anchor = sensors[0][1]
    with x64(precision):
        records = Records.from_sequences(sensors, commands)
        ratio = jitted_likelihood(records, *(jnp.asarray(x, precision) for x in (SIGMA, z, anchor)))
    got = np.log(np.asarray(ratio.mantissa, float)) + np.asarray(ratio.exponent) * np.log(2)
    got += norm.logpdf(z, anchor, SIGMA).sum()
    tolerance = {"float32": 1e-5, "float64": 1e-12}[precision]
    for row, record in zip(got, sensors, strict=True):
        want = reference.log_observation(z, record, SIGMA)
        np.testing.assert_allclose(row[: len(record)], want, rtol=tolerance, atol=tolerance)


jitted_likelihood = jax.jit(likelihood)


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
    assert weights[219, 1] == 0  # e^-8250: nothing a float could hold
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
        assert all(np.isfinite(x).all() for x in (posterior, u, log_evidence, *belief.p))
    assert (posterior.sum(2).argmax(1) == (1 if side > 0 else 2)).all()
    np.testing.assert_allclose(posterior.sum((1, 2)), 1, atol=1e-6)


def long_records(lengths=(200, 190, 200, 196)):
    """Variations of one slope, σ / 5 a sample, and observations passing one of them."""
    slope = 0.2 * SIGMA * np.arange(200)[:, None]
    sensors = [slope[:n] + SIGMA * noise(i, n, N_SENSORS) for i, n in enumerate(lengths)]
    commands = [noise(i, n, 2) for i, n in enumerate(lengths)]
    at = np.clip(np.cumsum(np.random.default_rng(0).choice([0, 1, 1, 1, 2], 210)), 0, 199)
    return (sensors, commands), sensors[2][at] + SIGMA * noise(9, len(at), N_SENSORS)


@both_readings
def test_window_holds_all_that_matters(jump):
    sequences, zs = long_records()
    params = Params(0.1, 0.05, SIGMA)
    dense, _ = run(build_filter(jump), sequences, zs, params)
    windowed, belief = run(build_filter(jump, window=32), sequences, zs, params)
    assert belief.p.mantissa.shape == (4, 32)
    assert NOTHING < belief.dropped < (-30 if jump == "same_tau" else 0)  # of each record
    assert np.min(belief.start) > 150
    for a, b in zip(windowed[:2] + windowed[3:], dense[:2] + dense[3:], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    np.testing.assert_allclose(windowed[2], dense[2], rtol=1e-5)


@both_readings
def test_window_reports_what_it_dropped(jump):
    (sensors, commands), zs = long_records()
    flat = [np.zeros_like(s) for s in sensors]
    params = Params(0.1, 0.5, SIGMA)
    f = build_filter(jump, window=32)
    _, early = run(f, (flat, commands), 0 * zs[:14], params)
    assert early.dropped == NOTHING  # after t steps τ is at most 2 t
    (posterior, *_), late = run(f, (flat, commands), 0 * zs[:150], params)
    assert -30 < late.dropped <= 0
    np.testing.assert_allclose(posterior.sum((1, 2)), 1, atol=1e-5)


@pytest.mark.parametrize("z", [0.0, [1.0, 2.0, 3.0], [[1.0, 2.0]]])
def test_observation_of_another_shape_is_an_error(z):
    records, f = Records.from_sequences(*random_sequences()), build_filter()
    shape = str(np.shape(z)).replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(ValueError, match=rf"z has shape {shape}; .* 2 sensors \(z0, z1\)"):
        f.update(records, Params(0.1, 0.05, SIGMA), f.init(records), z)


def test_sigma_of_another_shape_is_an_error():
    records, f = Records.from_sequences(*random_sequences()), build_filter()
    with pytest.raises(ValueError, match=r"sigma has shape \(1,\); .* 2 sensors"):
        f.update(records, Params(0.1, 0.05, SIGMA[:1]), f.init(records), np.zeros(2))


def test_a_filter_must_be_one_of_the_two_readings_with_a_window_that_can_move():
    with pytest.raises(ValueError, match="same_tau, own_tau; got 'both'"):
        build_filter("both")
    with pytest.raises(ValueError, match="at least 32 moments; got 31"):
        build_filter(window=31)


@own_tau_first
def test_gradients_of_log_evidence_are_its_differences(jump):
    sequences = random_sequences(8)
    sequences[0][0][4] = sequences[0][0][3]  # a segment of no length
    sequences[0][1][5] = sequences[0][1][4] + 1e-4
    zs = passing(sequences[0][0])[:10]
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
