"""What does a control step of the filter cost, against the fastest rivals we could write?

    python experiments/benchmarks/filter_step.py [--only A] [--rounds 7] [--json FILE]
    python experiments/benchmarks/filter_step.py --cold --scaling [--json FILE]

A step is update, end probability, prediction and command, for a batch of replays. Times are wall
time on all cores, divided by replays and steps. Within a round all rivals take turns; the table has
medians over rounds. Machines are noisy: trust the ratios.

Before it is timed, every rival is compared with the float64 reference on a smaller copy of the work
("error", of the posterior; "misses" where it exceeds the tolerance, see `work.py`). In windows ours
is an approximation wherever the belief is wider than they are; windows are fixed here, while
studies widen them rather than drop much (`live.py` measures what that costs).

The floor is the time that the error functions alone would take, one per sample and sensor. Memory
is the growth of the process up to its peak, and compile time is by how much the first call takes
longer than later ones, each in a fresh process.

Numba comes with `pip install -e '.[benchmark]'`; without it that rival and the floor are left out.
"""

import argparse
import json
import os
import platform
import re
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rivals import CORES, Share, numba_rival, numba_step, numpy_step, ours
from work import Rival, Work, errors, make_work, reference_beliefs

JUMPS = ("same_tau", "own_tau")
N_SENSORS = 7
WORKS = {  # N, L, replays of all but the slow, and of those, warm-up steps, steps timed a round
    "A": {"n": 20, "length": 1000, "replays": 105, "few": 4, "warm_up": 120, "steps": 20},
    "B": {"n": 50, "length": 5000, "replays": 28, "few": 2, "warm_up": 40, "steps": 4},
}
SMALL = {"n": 6, "length": 1000, "replays": 1, "steps": 200}
SLOW = ("NumPy",)
YARDSTICK = "ours, window 64"
SCALES = {
    "length": (1000, 2000, 4000, 8000, 16000),
    "n": (5, 10, 20, 40, 80),
    "replays": (1, 8, 64, 512, 4096),
}


def all_rivals() -> dict:
    """Return the rivals by name, each a function (work, replays) → Rival."""
    rivals = {name: partial(ours, window=window) for name, window in windows().items()}
    rivals["NumPy"] = numpy_step
    if numba_rival:
        rivals["Numba"] = numba_step
    return rivals


def windows() -> dict[str, int | None]:
    """Return ours by name: how many moments of each record are stored; None: all."""
    return {"ours, dense": None, "ours, window 256": 256, YARDSTICK: 64}


def main():
    """Measure, print the tables, and save them if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=WORKS, help="one of the two works")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--cold", action="store_true", help="instead: memory, time to compile")
    parser.add_argument("--scaling", action="store_true", help="instead: against L, N and batch")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    names = [options.only] if options.only else list(WORKS)

    saved = {"machine": machine(), "load before": os.getloadavg()}
    print(", ".join(f"{name} {value}" for name, value in saved["machine"].items()))
    print(f"load before: {saved['load before'][0]:.1f}")
    if options.scaling:
        saved["scaling"] = [scaling(what, options.rounds) for what in SCALES]
    if options.cold:
        saved["cold"] = {name: cold_table(name) for name in names}
    if not (options.scaling or options.cold):
        saved |= speed(names, options.rounds)
    saved["load after"] = os.getloadavg()
    print(f"load after: {saved['load after'][0]:.1f}")
    if options.json:
        options.json.write_text(json.dumps(saved, indent=1))


def speed(names: list[str], rounds: int) -> dict:
    """Return all rivals' errors and times, and the floor."""
    if not numba_rival:
        print("Numba is not installed: its rival and the floor are left out.")
    found = {jump: accuracy(jump) for jump in JUMPS}
    saved = {"errors": found, "floor": {}}
    per_error_function = error_function_seconds() if numba_rival else None
    for name in names:
        saved[name] = [table(name, jump, found[jump], rounds) for jump in JUMPS]
        if numba_rival:
            saved["floor"][name] = floor(name, per_error_function)
    return saved


def machine() -> dict[str, str | int]:
    """Return what the numbers depend on: processor and versions."""
    cpu = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    packages = ("jax", "jaxlib", "numpy", "scipy", *(("numba",) if numba_rival else ()))
    return {
        "CPU": cpu[1] if cpu else platform.processor(),
        "cores": CORES,
        "Python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def accuracy(jump: str) -> dict[str, dict[str, float]]:
    """Return every rival's errors on the small work, and whether they are tolerated."""
    work = make_work(jump, **SMALL)
    truth = list(reference_beliefs(work))
    found = {}
    for name, make in all_rivals().items():
        found[name] = errors(make(work, 1), work, truth)
        error = found[name]
        error["tolerated"] = error["posterior"] <= 1e-9 if name in SLOW else error["share"] <= 1
    return found


def table(name: str, jump: str, found: dict, rounds: int) -> dict:
    """Time all rivals on a work, in turn, and print the table."""
    size = WORKS[name]
    steps, warm_up = size["steps"], size["warm_up"]
    total = warm_up + rounds * steps
    work = make_work(jump, size["n"], size["length"], size["replays"], total)
    running, took = {}, {}
    for rival_name, make in all_rivals().items():
        replays = size["few" if rival_name in SLOW else "replays"]
        rival = make(work, replays)
        state, _ = advance(rival, rival.begin(), work, range(warm_up))
        running[rival_name], took[rival_name] = [rival, state, replays], []
    for r in range(rounds):
        at = range(warm_up + r * steps, warm_up + (r + 1) * steps)
        for rival_name, (rival, state, replays) in running.items():
            running[rival_name][1], seconds = advance(rival, state, work, at)
            took[rival_name].append(seconds / steps / replays)

    print(f"\nWork {name}, {jump}: N = {size['n']}, L = {size['length']}, n_s = {N_SENSORS};")
    print(f"{size['replays']} replays ({', '.join(SLOW)}: {size['few']}), µs a replay-step")
    print(f"{'':18}{'median':>9}{'lowest – highest':>20}", end="")
    print(f"{'× ' + YARDSTICK:>19}{'× NumPy':>10}{'error':>10}")
    rows = {}
    for rival_name, times in took.items():
        wall = 1e6 * np.array(times)
        error = found[rival_name]
        rows[rival_name] = row = {
            "replays": running[rival_name][2],
            "us_per_replay_step": float(np.median(wall)),
            "lowest": float(wall.min()),
            "highest": float(wall.max()),
            "times_yardstick": ratio(times, took[YARDSTICK]),
            "times_numpy": ratio(times, took["NumPy"]),
        }
        span = f"{row['lowest']:.0f} – {row['highest']:.0f}"
        print(f"{rival_name:18}{row['us_per_replay_step']:9.0f}{span:>20}", end="")
        print(f"{row['times_yardstick']:19.2f}", end="")
        print(f"{row['times_numpy']:10.3f}{error['posterior']:10.0e}", end="")
        print("" if error["tolerated"] else "  misses")
    return {"jump": jump, "work": size, "rows": rows}


def ratio(times: list, others: list) -> float:
    """Return by what factor a rival is slower than another, the median over rounds."""
    return float(np.median(np.array(times) / np.array(others)))


def advance(rival: Rival, state, work: Work, at: range):
    """Return the state after some steps, and the seconds that they took."""
    start = time.perf_counter()
    for t in at:
        state, *_ = rival.advance(state, work.observations[t])
    return state, time.perf_counter() - start


def error_function_seconds() -> float:
    """Return the time of one float32 error function, in a loop of nothing else on all cores."""
    took = []
    for _ in range(50):
        start = time.perf_counter()
        done = numba_rival.only_tails(20 * CORES)
        took.append((time.perf_counter() - start) / done)
    return min(took)


def floor(name: str, seconds: float) -> dict[str, float]:
    """Print and return the time that the error functions of a step alone would take."""
    size, found = WORKS[name], {"ns_per_error_function": 1e9 * seconds}
    print(f"Floor: at {1e9 * seconds:.2f} ns an error function, all cores:", end="")
    for rival_name, window in windows().items():
        stored = min(window or size["length"], size["length"])
        found[rival_name] = 1e6 * seconds * size["n"] * stored * N_SENSORS
        print(f" {rival_name.removeprefix('ours, ')} {found[rival_name]:.0f} µs;", end="")
    print()
    return found


def cold_table(name: str) -> dict[str, dict[str, float]]:
    """Print and return memory and compile time of ours, each in a process of its own."""
    size, found = WORKS[name], {}
    print(f"\nWork {name}, {size['replays']} replays")
    for jump in JUMPS:
        for rival_name, window in windows().items():
            with ProcessPoolExecutor(1, get_context("spawn")) as process:
                arguments = (jump, size["n"], size["length"], size["replays"], window)
                row = found[f"{rival_name}, {jump}"] = process.submit(cold, *arguments).result()
            print(f"{rival_name + ', ' + jump:28}{row['compile_s']:6.1f} s to compile", end="")
            print(f"{row['memory_mib']:8.0f} MiB more at the peak")
    return found


def cold(jump: str, n: int, length: int, replays: int, window: int | None) -> dict[str, float]:
    """Return compile time, and growth of the process, from the first step to the third."""
    work = make_work(jump, n, length, replays, 3)
    share, before = Share(work, replays, window), peak_memory()
    seconds = []
    for t, z in enumerate(work.observations):
        start = time.perf_counter()
        if t == 0:
            share.begin()
        share.advance(z)
        seconds.append(time.perf_counter() - start)
    return {
        "compile_s": seconds[0] - min(seconds[1:]),
        "memory_mib": (peak_memory() - before) / 1024,
    }


def peak_memory() -> int:
    """Return the peak memory of this process, KiB; ru_maxrss would start at its parent's."""
    return int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1])


def scaling(what: str, rounds: int) -> dict:
    """Time ours with one size of work A varied, and print the table."""
    base = {"n": 20, "length": 1000, "replays": 14}
    print(f"\nµs a replay-step (same_tau) against {what}, else {base}")
    print(f"{what:>18}" + "".join(f"{value:>10}" for value in SCALES[what]))
    found = {}
    for name, window in windows().items():
        print(f"{name:18}", end="", flush=True)
        found[name] = {}
        for value in SCALES[what]:
            sizes = base | {what: value}
            if window is None and sizes["replays"] > 512:  # some minutes
                print(f"{'–':>10}", end="")
                continue
            work = make_work("same_tau", steps=rounds + 1, **sizes)
            rival = ours(work, sizes["replays"], window)
            state, _ = advance(rival, rival.begin(), work, range(1))
            took = []
            for t in range(1, rounds + 1):
                state, seconds = advance(rival, state, work, range(t, t + 1))
                took.append(1e6 * seconds / sizes["replays"])
            found[name][value] = {
                "us_per_replay_step": float(np.median(took)),
                "lowest": min(took),
                "highest": max(took),
            }
            print(f"{np.median(took):10.0f}", end="", flush=True)
        print()
    return {"what": what, "else": base, "rows": found}


if __name__ == "__main__":
    main()
