import jax
import numpy as np
import pytest
from random_helpers import random_sequences
from study_helpers import by_robot

from jaxreplay import Params, Records, reference, replay
from jaxreplay.filter.options import Options
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import NOMINAL, SENSOR_RANGES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED, facing
from jaxreplay.study import again
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.demonstrations import record
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS
from jaxreplay.study.worlds.plane import Plane

OLD = PlaneParams(**NOMINAL)
PARAMS = Params([0.1], [0.05], 0.1 * np.array(SENSOR_RANGES)[None])
SEED = 5


@pytest.fixture(scope="module")
def records():
    """Demonstrations that end as the robot begins to advance, so that a replay is short."""
    sensors, commands = record(OLD, DEMONSTRATED[:6], 3).sequences()
    return Records.from_sequences([s[:90] for s in sensors], [c[:90] for c in commands])


@pytest.fixture(scope="module")
def options():
    return {"cube": facing(np.array([[0.3, -0.08]]))}


@pytest.fixture(scope="module")
def trace(records, options):
    plane = Plane(OLD, np.zeros((0, 2)), taught=False)
    return again.trace_of(plane, records, PARAMS, plane.make(1), Options("own_tau"), SEED, options)


def test_a_trace_has_every_step_of_the_replay(records, options, trace):
    replays = replay(
        records, PARAMS, PlaneVectorEnv(1, OLD), [SEED], jump="own_tau", options=options
    )
    n = replays.steps[0]
    *moving, params = trace.scene
    assert params == OLD
    for values in (trace.observations, trace.commands, trace.beliefs, *moving):
        assert len(values) == n
    assert replays.ending[0] == "completed"
    assert trace.ending == Plane.outcome(replays)[0] == "Fg"
    assert trace.period == OLD.control_period
    assert trace.records.lengths.tolist() == 6 * [90]
    assert trace.scene.robot[0, 0] == 0
    assert np.ptp(trace.scene.robot[:, 2]) > 0.01  # each pose is of its own step
    assert not trace.scene.held.any()
    np.testing.assert_array_equal(trace.observations[0, 1:], 0)


def test_beliefs_are_those_of_the_reference(records, trace):
    sensors = [s.astype(float) for s in records.sequences()[0]]
    one = jax.tree.map(lambda x: x[0], PARAMS)
    params = reference.Params(0.1, 0.05, np.asarray(one.sigma, float))
    want = reference.init(sensors)
    for t, z in enumerate(trace.observations):
        want = reference.predict(sensors, params, want, "own_tau")
        want, _ = reference.update(sensors, params, want, z.astype(float))
        np.testing.assert_allclose(trace.beliefs[t], np.exp(want), atol=1e-5)


def test_beliefs_do_not_depend_on_the_records_offset():
    """The walks are multiples of 1/4, which float32 stores exactly, with the offset or without."""
    walks, commands = random_sequences(0, (40, 32))
    walks = [np.round(4 * walk) / 4 for walk in walks]
    params = Params(0.1, 0.05, [1.0, 2.0])
    offset = np.array([500_000.0, 5_000_000.0])
    seen = []
    for by in (0, offset):
        records = Records.from_sequences([walk + by for walk in walks], commands)
        assert any(records.offset) == np.any(by)
        of = again.Beliefs(records, params, Options("own_tau"))
        seen.append([of(z) for z in walks[0] + by])
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-5)


def test_a_run_is_labelled_with_the_studys_values(monkeypatch, records, trace):
    fixed = {name: factor.default for name, factor in FACTORS.items() if name != "theta_i"}
    axes, positions = {"theta_i": (0.1, 0.2)}, ((0.3, -0.08), (0.3, 0.0))
    config = StudyConfig(axes, fixed, positions=positions, repeats=2)
    given = []

    def trace_of(world, records, params, worlds, how, seed, options, controller, follow):
        given.append((float(params.theta_i[0]), options["cube"][0, :2].tolist()))
        return trace

    monkeypatch.setattr(again, "trace_of", trace_of)
    robots = by_robot(config, records)
    runs = [again.run_again(config, robots, k) for k in range(8)]
    cells = [(t, p, r) for t in (0.1, 0.2) for p in (0, 1) for r in (0, 1)]
    labels = [(theta, f"position {p}, repeat {r}") for theta, p, r in cells]
    assert [(run.values["θ_I"], run.place) for run in runs] == labels
    assert [theta for theta, _ in given] == pytest.approx([theta for theta, *_ in cells])
    np.testing.assert_allclose([cube for _, cube in given], [positions[p] for _, p, _ in cells])
