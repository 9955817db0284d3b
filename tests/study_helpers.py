"""Studies on disk, whose results are made up instead of computed."""

import json
from functools import cache

import numpy as np
import xarray as xr

from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.records import Records
from jaxreplay.study import store
from jaxreplay.study.config import load_config
from jaxreplay.study.dataset import variables_of
from jaxreplay.study.demonstrations import record
from jaxreplay.study.runs import runs_of, shard_size, shards_of, taught_by
from jaxreplay.study.worlds.plane import OUTCOMES, STALLS
from jaxreplay.study.worlds.plane import VARIABLES as OWN

VARIABLES = variables_of(OUTCOMES, OWN)  # of a study on the plane

SMALL = """
seed = 4
repeats = 1
[axis]
theta_i = [0.01]
jump = ["own_tau"]
"""
VARIED = """
theta_i = 0.01
repeats = 2
sigma_proximeters = 0.2
positions = {x = [0.3, 0.35], y = {linspace = [-0.1, 0.1, 3]}}
zip = [["motor_unit", "sigma_camera"]]
[axis]
sigma_camera = [0.1, 0.3]
jump = ["own_tau", "same_tau"]
motor_unit = [0.005, 0.01]
records = [[0, 4, 19], 6]
sigma_proximeter_2 = [0.5]
"""
# As jaxreplay tune saves them.
TUNED = "theta_i = 0.03\ntheta_tau = 0.2\n[sigma]\n" + "".join(
    f'"{name}" = {0.05 * (k + 1)!r}\n' for k, name in enumerate(SENSOR_NAMES)
)


def write(folder, text, name="study.toml"):
    path = folder / name
    path.write_text(text)
    return path


def some_records(n=20, rows=5):
    """Records of the plane's sensors and commands; all rows of record i are i."""
    sensors = [np.full((rows, 7), float(i)) for i in range(n)]
    return Records.from_sequences(sensors, [np.zeros((rows, 5))] * n, SENSOR_NAMES, COMMAND_NAMES)


@cache
def beginnings():
    """Demonstrations that end as the robot begins to advance, so that runs are short."""
    sensors, commands = record(PlaneParams(), DEMONSTRATED, 3).sequences()
    return Records.from_sequences(
        [s[:90] for s in sensors], [c[:90] for c in commands], SENSOR_NAMES, COMMAND_NAMES
    )


def of_beginnings(folder, text):
    """The study of a text, of which the runs are short, written into a folder."""
    beginnings().save(folder / "beginnings.npz")
    return write(folder, f'demonstrations = "{folder / "beginnings.npz"}"\n{text}')


def by_robot(config, records):
    """The same demonstrations for each robot of a study."""
    runs = runs_of(config)
    return {taught_by(config, runs, k): records for k in range(len(runs))}


def made_up_study(config, folder, seed=0, **manifest):
    """Fill a folder with a finished study of random results; return its manifest.

    `manifest` are entries that differ from those of this version; None removes one.
    """
    config = load_config(config)
    runs, size = runs_of(config), shard_size(config)
    made = store.manifest_of(config, by_robot(config, some_records()), size) | manifest
    made = {name: entry for name, entry in made.items() if entry is not None}
    made["hash"] = store.hash_of(made)
    (folder / store.SHARDS).mkdir(parents=True, exist_ok=True)
    (folder / store.MANIFEST).write_text(json.dumps(made))
    rng = np.random.default_rng(seed)
    for k, which in enumerate(shards_of(config, runs, size)):
        n = len(which)
        outcome = rng.choice(list(OUTCOMES), n)
        results = {name: rng.uniform(1, 100, n) for name in VARIABLES} | {
            "outcome": outcome,
            "stall": np.where(outcome == "Fs", rng.choice(STALLS, n), ""),
            "lifted": np.where(outcome == "S", 1.0, rng.integers(0, 2, n)),
            "command_error": np.where(which % 5 == 0, rng.uniform(0, 0.01, n), np.nan),
        }
        shard = xr.Dataset({name: ("run", values) for name, values in results.items()})
        store.write_shard(folder, k, made, shard)
    return made


def as_made_before(folder, manifest, without=()):
    """Store another manifest, and the shards as an older version did: without a checksum."""
    manifest = {name: entry for name, entry in manifest.items() if name != "layout"}
    manifest["hash"] = store.hash_of(manifest)
    (folder / store.MANIFEST).write_text(json.dumps(manifest))
    for path in (folder / store.SHARDS).glob("*.nc"):
        with xr.open_dataset(path, engine="scipy") as shard:
            older = shard.drop_vars(without).load()
        older.attrs = {"study": manifest["hash"]}
        older.to_netcdf(path, engine="scipy")
    return manifest
