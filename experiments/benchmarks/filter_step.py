"""What a control step of the filter costs: dense, in a window, and in the NumPy reference.

    python experiments/benchmarks/filter_step.py [--replays 14] [--rounds 9] [--json FILE]

One process, all in turn within a round, medians over rounds: machines are noisy, trust the ratios.
The reference is float64 and written to be read: a yardstick, not the fastest NumPy there could be.
The work is the same for all: N = 20 records of L = 1000 samples of 7 sensors, observed along one
of them; a step is update, termination, prediction and command. The JAX batches run one replay
after the other on one thread, as the studies do (which run one thread a core).
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np

from jaxreplay import Params, Records, reference
from jaxreplay.tracker import steps

N, L, N_SENSORS, N_COMMANDS = 20, 1000, 7, 5
THETA_I, THETA_TAU, SIGMA = 0.01, 0.05, 0.1
STEPS = 5  # per measurement


def main():
    """Measure, print the table, and save it if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replays", type=int, default=14, help="replays in a batch")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()

    rng = np.random.default_rng(0)
    sensors = [0.02 * rng.normal(size=(L, N_SENSORS)).cumsum(0) for _ in range(N)]
    commands = [rng.normal(size=(L, N_COMMANDS)) for _ in range(N)]
    records = Records.from_sequences(sensors, commands)
    rivals = {}
    for jump in ("same_tau", "own_tau"):
        rivals[f"reference, {jump}"] = reference_yardstick(sensors, commands, jump)
        for window in (None, 256, 64):
            name = "dense" if window is None else f"window {window}"
            rivals[f"{name}, {jump}"] = jax_rival(records, sensors, jump, window, options.replays)

    for rival in rivals.values():  # compile, warm caches
        rival()
    took = {name: [] for name in rivals}
    for _ in range(options.rounds):
        for name, rival in rivals.items():
            took[name].append(rival())
    rows = {}
    for name, times in took.items():
        slowest = took[f"reference, {name.rsplit(', ', 1)[1]}"]
        ratio = float(np.median(np.array(slowest) / np.array(times)))
        rows[name] = {
            "us_per_replay_step": 1e6 * float(np.median(times)),
            "lowest": 1e6 * min(times),
            "highest": 1e6 * max(times),
            "times_reference": ratio,
        }
    print(f"{'':34}{'µs a replay-step':>18}{'(lowest – highest)':>22}{'× reference':>13}")
    for name, row in rows.items():
        span = f"({row['lowest']:.0f} – {row['highest']:.0f})"
        print(f"{name:34}{row['us_per_replay_step']:18.0f}{span:>22}{row['times_reference']:13.1f}")
    if options.json:
        machine = {"jax": jax.__version__, "numpy": np.__version__, "device": str(jax.devices()[0])}
        options.json.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))


def jax_rival(records, sensors, jump, window, replays):
    """A function that advances a batch by STEPS and returns seconds per replay-step."""
    sigma = np.full((replays, N_SENSORS), SIGMA)
    params = Params(np.full(replays, THETA_I), np.full(replays, THETA_TAU), sigma)
    compiled = steps(jump, window)
    on = np.ones(replays, dtype=bool)
    seen = [np.tile(records.centre(sensors[0][t]), (replays, 1)) for t in range(STEPS)]
    first, _ = compiled.begin(records, params)

    def run():
        belief = first
        start = time.perf_counter()
        for z in seen:
            belief, *_ = compiled.advance(records, params, belief, z, on)
        jax.block_until_ready(belief)
        return (time.perf_counter() - start) / STEPS / replays

    return run


def reference_yardstick(sensors, commands, jump):
    """The same for one replay under the float64 reference, vectorised along records."""
    sigma = np.full(N_SENSORS, SIGMA)

    def run():
        belief = reference.predict(sensors, THETA_I, THETA_TAU, reference.initial(sensors), jump)
        start = time.perf_counter()
        for t in range(STEPS):
            belief, _ = reference.update(sensors, sigma, belief, sensors[0][t])
            reference.end_probability(sensors, belief)
            belief = reference.predict(sensors, THETA_I, THETA_TAU, belief, jump)
            reference.command(commands, belief)
        return (time.perf_counter() - start) / STEPS

    return run


if __name__ == "__main__":
    main()
