"""Over a million updates of replays that follow, stall, stray, skip and lose sensors by chance."""

import jax
import numpy as np
import pytest
from filter_helpers import tolerance
from random_helpers import as_float32

from jaxreplay import Params, Records, build_filter, reference
from jaxreplay.filter.options import Options
from jaxreplay.loop.tracker import Tracker

N, LONGEST, N_SENSORS = 8, 48, 3
SETS, REPLAYS, STEPS = 16, 64, 1024  # 1,048,576 updates
LOOK = 32  # steps from one look at the whole beliefs to the next
HELD_AGAINST_THE_REFERENCE = 2  # replays of each set


def random_records(rng):
    """Sensors in σ, and commands: random walks, some short, some alike, some of one value."""
    walk = rng.choice([0, 1e-7, 1e-3, 0.1, 1])
    apart = rng.choice([0, 1e-30, 1e-7, 1e-3, 0.1, 1, 10])
    base = walk * rng.normal(size=(LONGEST, N_SENSORS)).cumsum(0)
    lengths = [LONGEST, *rng.choice([1, 2, 31, LONGEST], N - 1)]
    sensors = [(base + apart * rng.normal(size=base.shape))[:n] for n in lengths]
    levels = rng.choice([0, 1e-3, 5, 50]) * rng.normal(size=(N, N_SENSORS))
    commands = [as_float32(rng.uniform(-1, 1, (n, 2))) for n in lengths]
    return [s + level for s, level in zip(sensors, levels, strict=True)], commands


def random_way(rng, sensors):
    """What one replay observes, in σ."""
    ways = []
    while sum(map(len, ways)) < STEPS:
        record, other = (sensors[i] for i in rng.integers(N, size=2))
        start, lasts = rng.integers(len(record)), int(10 ** rng.uniform(0, 2.7))
        at = np.minimum(start + np.arange(lasts), len(record) - 1)
        stray = 10.0 ** rng.uniform(-3, 1) * rng.normal(size=(lasts, N_SENSORS))
        aside = 10.0 ** rng.uniform(0, 3) * rng.normal(size=N_SENSORS)
        ways.append(
            [
                record[at] + stray,
                np.tile(record[start], (lasts, 1)),
                np.tile((record[start] + other[-1]) / 2, (lasts, 1)) + stray,
                record[at[:20]] + aside,
            ][rng.integers(4)]
        )
    zs = np.concatenate(ways)[:STEPS]
    zs[rng.random(zs.shape) < 0.02] = np.nan
    return zs


def random_params(rng):
    """For all replays of a set, as float32 holds them."""
    theta_i = rng.choice([0, 1e-30, 1e-6, 0.01, 0.1, 0.5, 1], REPLAYS)
    theta_tau = rng.choice([0, 0.01, 0.05, 0.3, 0.5], REPLAYS)
    return as_float32(theta_i), as_float32(theta_tau)


def follow_reference(sensors, commands, zs, theta_i, theta_tau, sigma, jump):
    """Predicted belief, its command and the log evidence after every step."""
    params = reference.Params(theta_i, theta_tau, sigma)
    belief = reference.predict(sensors, params, reference.init(sensors), jump)
    for z in zs:
        belief, log_evidence = reference.update(sensors, params, belief, z)
        belief = reference.predict(sensors, params, belief, jump)
        yield np.exp(belief), reference.command(commands, belief), log_evidence


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SETS))
def test_many_random_updates_stay_finite_and_agree_with_the_reference(seed):
    rng, jump = np.random.default_rng(seed), ("same_tau", "own_tau")[seed % 2]
    sigma = as_float32(10.0 ** rng.uniform(-6, 6, N_SENSORS))
    in_sigmas, commands = random_records(rng)
    sensors = [as_float32(s * sigma) for s in in_sigmas]
    ways = [as_float32(sigma * random_way(rng, in_sigmas)) for _ in range(REPLAYS)]
    theta_i, theta_tau = random_params(rng)

    records = Records.from_sequences(sensors, commands)
    params = Params(theta_i, theta_tau, np.tile(sigma, (REPLAYS, 1)))
    tracker, going = Tracker(records, params, Options(jump), windows=()), np.ones(REPLAYS, bool)
    posterior = jax.vmap(build_filter(jump).posterior, in_axes=(None, 0))
    sample = list(range(HELD_AGAINST_THE_REFERENCE))
    wanted = [
        follow_reference(sensors, commands, ways[b], theta_i[b], theta_tau[b], sigma, jump)
        for b in sample
    ]
    allowed = np.array([tolerance(sensors, ways[b], sigma) for b in sample])

    for t, z in enumerate(np.stack(ways, axis=1)):
        evidence, _ = tracker.observe(z, going)
        command = tracker.command
        assert np.isfinite(command).all()
        assert np.isfinite(evidence).all()
        want_p, want_command, want_evidence = zip(*map(next, wanted), strict=True)
        off = np.abs(command[sample] - want_command).max(1) / allowed[:, t]
        assert off.max() <= 1, (t, off)
        np.testing.assert_allclose(evidence[sample], want_evidence, rtol=1e-4, atol=1e-4)
        if t % LOOK == LOOK - 1:
            beliefs = [tracker.belief(b) for b in range(REPLAYS)]
            p = np.asarray(posterior(records, jax.tree.map(lambda *x: np.stack(x), *beliefs)))
            np.testing.assert_allclose(p.sum((1, 2)), 1, atol=1e-5)
            off = np.abs(p[sample] - np.array(want_p)).max((1, 2)) / allowed[:, t]
            assert off.max() <= 1, (t, off)
