"""How long does a robot wait for its next command, one replay at a time?

    python experiments/benchmarks/live.py [--steps 1500] [--json FILE]

N = 50 records of L = 5000 samples of 7 sensors, observed along one of them. "Windows" is
`jr.Replayer`, `observe` and `command` together, as a robot would call it. "Dense" composes
`jr.build_filter(jump)` without windows into one compiled step, NumPy in and NumPy out, as the
Replayer always starts in a window. Both take turns step by step. The last column is the share of
steps that began in each width of window: the Replayer widens to all moments where it must, and is
then no faster than dense.
"""

import argparse
import json
import time
from functools import partial
from pathlib import Path

import jax
import numpy as np
from work import SIGMA, THETA_I, THETA_TAU, make_work

import jaxreplay as jr
from jaxreplay.loop.lanes import COMPILER_OPTIONS

N, L, N_SENSORS = 50, 5000, 7
WARM_UP = 20  # steps not counted


def main():
    """Measure, print the table, and save it if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()

    rows = []
    print(f"{'ms a step':22}{'p50':>9}{'p99':>9}{'max':>9}{'apart':>10}  moments stored: steps")
    for jump in ("same_tau", "own_tau"):
        for name, row in measure(jump, options.steps).items():
            rows.append({"jump": jump, "rival": name, **row})
            times = "".join(f"{row[key]:9.2f}" for key in ("p50", "p99", "max"))
            stored = ", ".join(f"{width}: {part:.0%}" for width, part in row["stored"].items())
            print(f"{name + ', ' + jump:22}{times}{row['apart']:10.0e}  {stored}")
    print(
        "apart: the largest difference from dense in any command, as a share of the commands' range"
    )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def measure(jump: str, steps: int) -> dict[str, dict]:
    """Return the milliseconds that a step takes in both, and how far their commands differ."""
    work = make_work(jump, N, L, 1, WARM_UP + steps)
    records = jr.Records.from_sequences(list(work.sensors), list(work.commands))
    params = jr.Params(THETA_I, THETA_TAU, np.full(N_SENSORS, SIGMA))
    replayer, dense = jr.Replayer(records, params, jump), Dense(records, params, jump)
    took = {"windows": [], "dense": []}
    tracker, widths = replayer._tracker, []
    apart = 0.0
    replayer.command()
    for z in work.observations[:, 0]:
        widths.append(tracker.windows[tracker.window[0]] or L)
        start = time.perf_counter()
        replayer.observe(z)
        command = replayer.command()
        between = time.perf_counter()
        dense_command = dense.step(z)
        took["dense"].append(time.perf_counter() - between)
        took["windows"].append(between - start)
        apart = max(apart, float(np.abs(command - dense_command).max()))
    stored = {str(width): widths.count(width) / len(widths) for width in sorted(set(widths))}
    found = {
        "windows": {"apart": apart / float(np.ptp(work.commands)), "stored": stored},
        "dense": {"apart": 0.0, "stored": {str(L): 1.0}},
    }
    for name, times in took.items():
        counted = 1e3 * np.array(times[WARM_UP:])
        p50, p99 = np.quantile(counted, [0.5, 0.99]).tolist()
        found[name] |= {"p50": p50, "p99": p99, "max": float(counted.max())}
    return found


class Dense:
    """One replay without windows."""

    def __init__(self, records: jr.Records, params: jr.Params, jump: str):
        """Begin, and make the first prediction."""
        filter = jr.build_filter(jump)
        self.belief = filter.predict(records, params, filter.init(records))

        @partial(jax.jit, compiler_options=COMPILER_OPTIONS)
        def step(belief, z):
            belief, log_evidence = filter.update(records, params, belief, z)
            ended = filter.end_probability(records, belief)
            belief = filter.predict(records, params, belief)
            return belief, filter.command(records, belief), log_evidence, ended

        self.compiled = step

    def step(self, z: np.ndarray) -> np.ndarray:
        """Update with an observation, and return the next command."""
        self.belief, *results = self.compiled(self.belief, z.astype(np.float32))
        command, _, _ = (np.asarray(result) for result in results)
        return command


if __name__ == "__main__":
    main()
