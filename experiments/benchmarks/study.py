"""What does a study cost: wall time, simulated seconds a second, memory; where does time go?

    python experiments/benchmarks/study.py [--rounds 3] [--jump own_tau] [--large] [--json FILE]

The first table is the paper's Figure 3, one reading, 105 runs, as the command line runs it: with
an empty cache of compiled code, in one process, and with one and two workers, by turns. Process
start, imports and drawing are counted, recording the demonstrations is not. The second shows where
the time of one core goes in one process. `--large` runs grids of 2,000 and 10,000 runs, to see what
workers gain, and whether memory grows; they replay the first 15 s of the demonstrations only.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

import jaxreplay as jr
from jaxreplay.loop.tracker import Tracker
from jaxreplay.machine import keep_compiled
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.world import World
from jaxreplay.study.config import load_config
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.runs import runs_of
from jaxreplay.study.shard import replays_of

THETA_I = Path(__file__).parents[1] / "theta_i.toml"
SHORT = 150  # samples
PAPER = "axis.theta_i.logspace=[-0.5, -3.5, 7]"
WAYS = {  # arguments, and whether with a cache of its own
    "from cold": ([], True),
    "one process": ([], False),
    "1 worker": (["--workers", "1"], False),
    "2 workers": (["--workers", "2"], False),
}


def main():
    """Measure, print the tables, and save them if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--jump", default="own_tau", choices=("same_tau", "own_tau"))
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        config = load_config(THETA_I, [f"jump={options.jump}", PAPER])
        robots = demonstrations(config, folder)
        (file,) = folder.glob("*.npz")
        given = ["--set", f"jump={options.jump}", "--set", f"demonstrations={file}"]
        found = {"figure 3": figure_3([*given, "--set", PAPER], folder, options.rounds)}
        with on_one_core():
            found["parts"] = parts(config, robots)
        if options.large:
            found["large"] = large(next(iter(robots.values())), folder)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def figure_3(given: list[str], folder: Path, rounds: int) -> dict:
    """Time each way by turns; print and return medians."""
    took = defaultdict(list)
    run(given, folder / "warm up", None)
    for k in range(rounds):
        for way, (how, cold) in WAYS.items():
            cache = folder / f"cache {k}" if cold else None
            took[way].append(run(given + how, folder / f"{way} {k}", cache))
    found = {}
    print(f"{'Figure 3, 105 runs':22}{'wall, s':>9}{'simulated s/s':>15}{'peak, GiB':>11}")
    for way, each in took.items():
        wall, rate, peak = np.median(each, axis=0)
        found[way] = {"wall": wall, "rate": rate, "peak": peak, "each": each}
        print(f"{way:22}{wall:9.1f}{rate:15.0f}{peak:11.2f}")
    return found


def run(given: list[str], out: Path, cache: Path | None) -> tuple[float, float, float]:
    """Run a study; return seconds, simulated seconds a second, and peak GiB of its processes."""
    command = [
        str(Path(sys.executable).with_name("jaxreplay")),
        "run",
        str(THETA_I),
        "--out",
        str(out),
    ]
    environment = os.environ | ({"XDG_CACHE_HOME": str(cache)} if cache else {})
    began = time.perf_counter()
    process = subprocess.Popen(
        command + given, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    peak = [0]
    watch = threading.Thread(target=_watch, args=(psutil.Process(process.pid), peak))
    watch.start()
    _, error = process.communicate()
    wall = time.perf_counter() - began
    watch.join()
    if process.returncode:
        sys.exit(error.decode())
    simulated = float(jr.open_study(out).duration.sum())
    return wall, simulated / wall, peak[0] / 2**30


def _watch(process: psutil.Process, peak: list[int]):
    while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
        try:
            family = [process, *process.children(recursive=True)]
            peak[0] = max(peak[0], sum(p.memory_info().rss for p in family))
        except psutil.NoSuchProcess:
            pass
        time.sleep(0.2)


def parts(config, robots) -> dict[str, float]:
    """Print and return where one core's time goes, for 56 runs: µs a control step of one run."""
    keep_compiled()
    runs = runs_of(config)
    sample = runs.of(np.unique(np.linspace(0, len(runs) - 1, 56).astype(int)))
    replays_of(config, robots, sample)  # compiles
    spent = defaultdict(float)
    with (
        timed(spent, "filter", Tracker, "observe"),
        timed(spent, "plane", PlaneVectorEnv, "step"),
        timed(spent, "sensors", PlaneVectorEnv, "_observe"),
        timed(spent, "physics", World, "advance"),
    ):
        began = time.perf_counter()
        steps = int(replays_of(config, robots, sample).steps.sum())
        whole = time.perf_counter() - began
    each = {
        "filter": spent["filter"],
        "physics": spent["physics"],
        "sensors": spent["sensors"],
        "actuators and magnet": spent["plane"] - spent["physics"] - spent["sensors"],
        "the rest": whole - spent["filter"] - spent["plane"],
        "all": whole,
    }
    print(f"\n{'one core, 56 runs':22}{'µs a step':>11}{'share':>8}")
    for name, seconds in each.items():
        print(f"{name:22}{1e6 * seconds / steps:11.0f}{seconds / whole:8.0%}")
    return {name: 1e6 * seconds / steps for name, seconds in each.items()}


@contextmanager
def on_one_core():
    """Restrict this process to one core, where the system allows it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    mine = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(mine)})
    yield
    os.sched_setaffinity(0, mine)  # processes started from here on get all again


@contextmanager
def timed(spent: dict[str, float], name: str, owner, attribute: str):
    """Add up the time that calls of a function take."""
    function = getattr(owner, attribute)

    def measured(*args):
        began = time.perf_counter()
        try:
            return function(*args)
        finally:
            spent[name] += time.perf_counter() - began

    setattr(owner, attribute, measured)
    yield
    setattr(owner, attribute, function)


def large(records: jr.Records, folder: Path) -> dict:
    """Run grids of two sizes, all else being equal; print and return their costs."""
    found, file = {}, folder / "short.npz"
    sensors, commands = ([rows[:SHORT] for rows in each] for each in records.sequences())
    names = records.sensor_names, records.command_names
    jr.Records.from_sequences(sensors, commands, *names, records.period).save(file)
    grid = ["axis.sigma.logspace=[-1.5, -0.5, 20]", "axis.theta_i.logspace=[-0.5, -3.5, 10]"]
    print(f"\n{'runs of 15 s':22}{'wall, s':>9}{'simulated s/s':>15}{'peak, GiB':>11}")
    for workers, repeats in ((1, 2), (2, 2), (2, 10)):
        changes = [*grid, "jump=own_tau", f"demonstrations={file}", f"repeats={repeats}"]
        sets = [word for change in changes for word in ("--set", change)]
        name = f"{1000 * repeats:,}, {workers} worker{'s' * (workers > 1)}"
        wall, rate, peak = run([*sets, "--workers", str(workers)], folder / name, None)
        found[name] = {"wall": wall, "rate": rate, "peak": peak}
        print(f"{name:22}{wall:9.1f}{rate:15.0f}{peak:11.2f}", flush=True)
    return found


if __name__ == "__main__":
    main()
