"""What a study costs: wall time, simulated seconds a second, memory, and where the time goes.

    python experiments/benchmarks/study.py [--rounds 3] [--jump own_tau] [--large] [--json FILE]

The first table is the paper's Figure 3, one reading, 105 runs, as the command line runs it: with
an empty cache of compiled code, in one process, and with one and two workers, by turns. Process
start, imports and drawing are counted, recording the demonstrations is not. The second says where
the time of one core goes in one process. `--large` runs grids of 2,000 and 10,000 runs, to see what
workers gain, and if memory grows; they replay the first 15 s of the demonstrations, to be short.
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
from jaxreplay.config import load_config
from jaxreplay.machine import keep_compiled
from jaxreplay.plane import env
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.runs import runs_of
from jaxreplay.study import demonstrations, replays_of
from jaxreplay.tracker import Tracker

THETA_I = Path(__file__).parents[1] / "theta_i.toml"
SHORT = 150  # samples
PAPER = "axis.theta_i.logspace=[-0.5, -3.5, 7]"
WAYS = {  # how, and with a cache of its own
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
        records = demonstrations(config, folder)
        (file,) = folder.glob("*.npz")
        given = ["--set", f"jump={options.jump}", "--set", f"demonstrations={file}"]
        found = {"figure 3": figure_3([*given, "--set", PAPER], folder, options.rounds)}
        with on_one_core():
            found["parts"] = parts(config, records)
        if options.large:
            found["large"] = large(records, folder)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def figure_3(given: list[str], folder: Path, rounds: int) -> dict:
    """Each way by turns; medians."""
    took = defaultdict(list)
    run(given, folder / "warm up", None)
    for k in range(rounds):
        for way, (how, cold) in WAYS.items():
            cache = folder / f"cache {k}" if cold else None
            took[way].append(run(given + how, folder / f"{way} {k}", cache))
    told = {}
    print(f"{'Figure 3, 105 runs':22}{'wall, s':>9}{'simulated s/s':>15}{'peak, GiB':>11}")
    for way, each in took.items():
        wall, rate, peak = np.median(each, axis=0)
        told[way] = {"wall": wall, "rate": rate, "peak": peak, "each": each}
        print(f"{way:22}{wall:9.1f}{rate:15.0f}{peak:11.2f}")
    return told


def run(given: list[str], out: Path, cache: Path | None) -> tuple[float, float, float]:
    """One study: seconds, simulated seconds a second, and GiB of all its processes at most."""
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


def parts(config, records) -> dict[str, float]:
    """Where the time of one core goes, for 56 runs; µs a control step of one run."""
    keep_compiled()
    runs = runs_of(config)
    sample = runs.of(np.unique(np.linspace(0, len(runs) - 1, 56).astype(int)))
    replays_of(config, records, sample)  # compiles
    spent = defaultdict(float)
    with (
        timed(spent, "filter", Tracker, "advance"),
        timed(spent, "plane", PlaneVectorEnv, "step"),
        timed(spent, "sensors", PlaneVectorEnv, "_look"),
        timed(spent, "physics", env, "advance"),
    ):
        began = time.perf_counter()
        steps = int(replays_of(config, records, sample).steps.sum())
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
    """This process alone, where that can be told."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    mine = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(mine)})
    yield
    os.sched_setaffinity(0, mine)  # those that are started from here on get all again


@contextmanager
def timed(spent: dict[str, float], name: str, owner, attribute: str):
    """Add up the time that a function takes."""
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
    """Grids of two sizes, alike in all else."""
    told, file = {}, folder / "short.npz"
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
        told[name] = {"wall": wall, "rate": rate, "peak": peak}
        print(f"{name:22}{wall:9.1f}{rate:15.0f}{peak:11.2f}", flush=True)
    return told


if __name__ == "__main__":
    main()
