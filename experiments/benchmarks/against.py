"""Is this checkout faster than another? The same observations, in turn, in fresh processes.

    git worktree add ../old f1c500c
    python experiments/benchmarks/against.py ../old [--rounds 3] [--json FILE]

28 runs of Figure 3 are replayed once, and their observations kept. Then both checkouts filter them
on one core, as a study does (µs a step and replay), and as a live robot does (CPU a step, and CPU
to build a `Replayer`). Ratios are of medians over rounds. The other checkout needs a `Tracker` in
`jaxreplay.loop.tracker` or, before there were packages, in `jaxreplay.tracker`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from importlib import import_module
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve()
READINGS = ("own_tau", "same_tau")
RUNS, SIGMA, THETA_TAU = 28, 0.1, 0.05
PAPER = "axis.theta_i.logspace=[-0.5, -3.5, 7]"


def main():
    """Measure both, print the table, and save it if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("other", type=Path, help="the root of the other checkout")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--measure", nargs=2, metavar=("FOLDER", "READING"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(Path(options.measure[0]), options.measure[1])))
        return
    found = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for jump in READINGS:
            observe(Path(folder), jump)
        for _ in range(options.rounds):
            for jump in READINGS:
                for root in (options.other.resolve(), HERE.parents[2]):
                    for name, value in in_checkout(root, folder, jump).items():
                        found[f"{name}, {jump}"].append((root == HERE.parents[2], value))
    rows = {}
    print(f"{'':42}{'other':>9}{'this':>9}{'ratio':>8}")
    for name, values in found.items():
        other, this = (np.median([v for mine, v in values if mine == which]) for which in (0, 1))
        rows[name] = {"other": other, "this": this, "ratio": this / other}
        print(f"{name:42}{other:9.3g}{this:9.3g}{this / other:8.2f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def observe(folder: Path, jump: str) -> None:
    """Replay 28 runs with this checkout; save records, observations and θ_I."""
    from jaxreplay.study.config import load_config
    from jaxreplay.study.demonstrations import demonstrations
    from jaxreplay.study.runs import runs_of
    from jaxreplay.study.shard import replays_of

    config = load_config(HERE.parents[1] / "theta_i.toml", [f"jump={jump}", PAPER])
    robots = demonstrations(config, folder)
    runs = runs_of(config)
    runs = runs.of(np.unique(np.linspace(0, len(runs) - 1, RUNS).astype(int)))
    kept = replays_of(config, robots, runs, list(range(len(runs)))).observations
    next(iter(robots.values())).save(folder / "records.npz")
    np.savez(
        folder / f"{jump}.npz",
        observations=np.concatenate([np.array(kept[k]) for k in range(len(runs))]),
        steps=[len(kept[k]) for k in range(len(runs))],
        theta_i=np.array(runs.values["theta_i"], float),
    )


def in_checkout(root: Path, folder: str, jump: str) -> dict[str, float]:
    """Measure the checkout at a root in a process of its own, on one core."""
    environment = os.environ | {"PYTHONPATH": str(root)}
    command = [sys.executable, str(HERE), str(root), "--measure", folder, jump]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def measure(folder: Path, jump: str) -> dict[str, float]:
    """Return what the checkout that is imported here takes."""
    import jaxreplay as jr

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    try:
        tracker = import_module("jaxreplay.loop.tracker").Tracker
    except ModuleNotFoundError:
        tracker = import_module("jaxreplay.tracker").Tracker
    records = jr.Records.load(folder / "records.npz")
    saved = dict(np.load(folder / f"{jump}.npz"))  # reads each array once
    replays = np.split(saved["observations"], np.cumsum(saved["steps"])[:-1])
    sigma = np.full(replays[0].shape[1], SIGMA)

    began = time.process_time()
    replayer = jr.Replayer(records, jr.Params(0.01, THETA_TAU, sigma), jump)
    build = time.process_time() - began
    for timed in (False, True):
        replayer.reset()
        began = time.process_time()
        for z in replays[0][:400]:
            replayer.command()
            replayer.observe(z)
        live = (time.process_time() - began) / min(400, len(replays[0])) if timed else 0.0

    n = len(replays)
    try:
        how = import_module("jaxreplay.filter.options").Options(jump)
    except ModuleNotFoundError:
        how = jump
    params = jr.Params(saved["theta_i"], np.full(n, THETA_TAU), np.tile(sigma, (n, 1)))
    for timed in (False, True):  # the first compiles
        tracked = tracker(records, params, how)
        step = getattr(tracked, "observe", None) or tracked.advance
        began = time.perf_counter()
        for t in range(saved["steps"].max()):
            z = np.stack([rows[min(t, len(rows) - 1)] for rows in replays])
            step(z, t < saved["steps"])
        study = (time.perf_counter() - began) / saved["steps"].sum() if timed else 0.0
    return {
        "filter step in a study, µs": 1e6 * study,
        "live step, CPU ms": 1e3 * live,
        "Replayer, CPU s to build": build,
    }


if __name__ == "__main__":
    main()
