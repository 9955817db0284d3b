from functools import cache

import jax
import numpy as np
import pytest
from filter_helpers import both_readings, case, noise, own_tau_first, params_of
from random_helpers import as_float32

from jaxreplay import Params, Records
from jaxreplay.filter.options import Options
from jaxreplay.loop import tracker
from jaxreplay.loop.audit import audit
from jaxreplay.loop.lanes import steps
from jaxreplay.loop.tracker import Tracker

SIGMA = as_float32([0.7, 2.3])
REPLAYS, STEPS = 13, 150
LENGTHS = (600, 580, 600, 550)  # more than any window but the last


def alike(lengths, slope=0.0, walk=0.0, apart=0.3):
    """Records along one way: so many σ a sample, a random walk, and a noise of their own."""
    way = slope * np.arange(lengths[0])[:, None] + walk * noise(0, lengths[0], 2).cumsum(0)
    return [SIGMA * (way + apart * noise(i, len(way), 2))[:n] for i, n in enumerate(lengths, 1)]


@cache
def replays():
    """Records, and parameters and observations of 13 replays: at places of all records."""
    sensors = alike(LENGTHS, slope=0.05)
    records = Records.from_sequences(sensors, [noise(i, len(s), 2) for i, s in enumerate(sensors)])
    rng = np.random.default_rng(0)
    params = Params(
        rng.choice([0, 1e-6, 0.1, 1], REPLAYS),
        rng.choice([0, 0.05, 0.3, 0.5], REPLAYS),
        SIGMA * rng.uniform(0.5, 2, (REPLAYS, 1)),
    )
    pace = rng.uniform(0, 2, REPLAYS)
    at = (np.arange(STEPS)[:, None] * pace).astype(int)
    zs = sensors[0][at] + SIGMA * noise(1, STEPS, REPLAYS, 2)
    zs[20:30, 4] += 500 * SIGMA
    zs[rng.random(zs.shape) < 0.05] = np.nan
    going = rng.random((STEPS, REPLAYS)) < 0.9
    again = rng.random((STEPS, REPLAYS)) < 0.004
    return records, params, as_float32(zs), going, again


def taken(tree, order):
    return jax.tree.map(lambda x: x[np.array(order)], tree)


def bits(tree, b=...):
    return b"".join(np.asarray(leaf)[b].tobytes() for leaf in jax.tree.leaves(tree))


def tracked(jump, order):
    """What becomes of replays tracked together: the bits of each, and how often one widened."""
    records, params, zs, going, again = replays()
    params = taken(params, order)
    tracked, lives = Tracker(records, params, Options(jump), NARROW), [b""] * len(order)
    for z, go, restart in zip(zs[:, order], going[:, order], again[:, order], strict=True):
        tracked.begin(restart, params)
        results = *tracked.observe(z, go), tracked.command, tracked.window
        lives = [life + bits(results, b) for b, life in enumerate(lives)]
    return [life + bits(tracked.belief(b)) for b, life in enumerate(lives)], tracked.widened.sum()


ORDERS = [[9], list(range(REPLAYS))[::-1]]
NARROW = (128,)  # to compile less


@own_tau_first
def test_what_becomes_of_a_replay_does_not_depend_on_those_beside_it(jump):
    together, widened = tracked(jump, list(range(REPLAYS)))
    assert widened > 0
    assert len(set(together)) == REPLAYS
    for order in ORDERS:
        assert tracked(jump, order)[0] == [together[b] for b in order], order


@own_tau_first
def test_other_values_compile_nothing_new(jump):
    records, params, zs, going, again = replays()
    everyone = list(range(REPLAYS))
    tracked(jump, everyone)
    compiled = [steps(jump, w)._asdict() for w in (*NARROW, None)]
    before = [{name: step._cache_size() for name, step in each.items()} for each in compiled]
    sensors, commands = records.sequences()
    sensors = [2 * s for s in (sensors[0], sensors[1][:90], sensors[2][:1], sensors[3])]
    commands = [c[: len(s)] - 1 for c, s in zip(commands, sensors, strict=True)]
    others = Records.from_sequences(sensors, commands)
    params = Params(np.full(REPLAYS, 0.3), np.zeros(REPLAYS), 2 * np.asarray(params.sigma))
    other = Tracker(others, params, Options(jump), NARROW)
    for z, go, restart in zip(3 * zs, going, again, strict=True):
        other.begin(restart, params)
        other.observe(z, go)
    after = [{name: step._cache_size() for name, step in each.items()} for each in compiled]
    assert after == before


def stalled(sensors, noisy, on=1, **thetas):
    """Along a record to its 150th sample, 500 steps there, then from `on` samples further on."""
    at = np.concatenate([np.arange(150), np.full(500, 150), np.arange(150 + on, 200 + on)])
    return case(sensors, sensors[2][at] + noisy * SIGMA * noise(9, len(at), 2), SIGMA, **thetas)


def strayed(away, lasts):
    """Along a record, but for some steps `away`."""
    sensors = alike(LENGTHS, slope=0.2)
    zs = sensors[2][:300] + SIGMA * noise(9, 300, 2)
    zs[150 : 150 + lasts] += away * SIGMA
    return case(sensors, zs, SIGMA)


def turned_back():
    """500 steps at one place, then as long at one 150 samples before it."""
    sensors = alike(LENGTHS, slope=0.2, apart=0.1)
    at = np.concatenate([np.arange(300), np.full(500, 300), np.full(600, 150)])
    return case(sensors, sensors[2][at], SIGMA, theta_tau=0.3)


CASES = {
    "stalled": lambda: stalled(alike(LENGTHS, slope=0.2), 0.5),
    "stalled without noise": lambda: stalled(alike(LENGTHS, slope=0.2), 0, theta_tau=0.5),
    "stalled where much is alike": lambda: stalled(alike(LENGTHS, slope=0.02), 0.5),
    "stalled on a walk": lambda: stalled(alike(LENGTHS, walk=0.5), 0.5, on=40, theta_i=0.01),
    "stalled, no jumps": lambda: stalled(alike(LENGTHS, walk=0.5), 0.5, on=-40, theta_i=0),
    "stalled, jumps of 1e-30": lambda: stalled(alike(LENGTHS, slope=1), 0.5, theta_i=1e-30),
    "strayed by 30 σ": lambda: strayed(30, 40),
    "strayed by 100 σ": lambda: strayed(100, 40),
    "strayed by 1000 σ": lambda: strayed(1000, 2),
    "turned back": turned_back,
}


def assert_windows_cost_nothing(case, jump):
    records = Records.from_sequences(case.sensors, case.commands)
    found = audit(records, params_of(case), Options(jump), case.zs)
    assert found.total_variation <= 1e-4
    assert found.command <= 1e-4


@pytest.mark.parametrize("name", ["stalled on a walk", "strayed by 30 σ", "turned back"])
def test_a_narrow_window_costs_nothing(name, monkeypatch):
    monkeypatch.setattr(tracker, "WINDOWS", NARROW)
    assert_windows_cost_nothing(CASES[name](), "own_tau")


@pytest.mark.slow
@both_readings
@pytest.mark.parametrize("name", CASES)
def test_windows_cost_nothing(name, jump):
    assert_windows_cost_nothing(CASES[name](), jump)


@pytest.mark.slow
def test_windows_widen_where_much_is_alike():
    case = CASES["stalled where much is alike"]()
    records = Records.from_sequences(case.sensors, case.commands)
    tracked = Tracker(
        records, jax.tree.map(lambda x: x[None], params_of(case)), Options("same_tau")
    )
    for z in case.zs:
        tracked.observe(z[None], np.array([True]))
    assert tracked.widened >= 2
    assert tracked.window > 0
