"""How many physics substeps does a control step (0.1 s) need: what do fewer of them change?

    python experiments/benchmarks/substeps.py [--worlds 32] [--json FILE]

The same open-loop action logs, without wheel noise, in worlds whose cubes lie slightly differently;
each world is compared with the same one at 160 substeps: at the end of the log and, for the robot,
also where they were furthest apart on the way. Contact amplifies differences in some worlds and a
grasp is all or nothing: one large difference is no failure to converge, a median that does not fall
is. The row "noise" is the yardstick: the reference with the wheel noise of every run. A teacher
drives at 1–3 motor units, these at 2–8; "fast push" and "stop" (from top speed, pushing the cube)
are beyond. All counts advance side by side, each control step timed in turn; the time is the
median, whole environment included. Machines are noisy: trust the ratios.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.params import NOMINAL, PlaneParams

COUNTS = (1, 2, 3, 5, 10, 20, 40)
REFERENCE = 160
P = PlaneParams(**NOMINAL)
LOW, SCANNING, LIFTING = P.low, (P.low, P.scanning_tilt, 0), (P.high, 0, 1)
LOWER = (3.5, 0, 0, *SCANNING)  # s, motor units left and right, set points and magnet
STAND = (1, 0, 0, *SCANNING)
NEAR = P.reach + P.side / 2  # of a cube that touches the magnet

# Where cubes lie (x, y in m, angle in rad), how much each of these varies (±), and what is sent.
SCENARIOS = {
    "push": ((NEAR + 0.02, 0, 0), (0.01, 0.01, 0.2), [LOWER, (5, 4, 4, *SCANNING), STAND]),
    "fast push": ((NEAR + 0.02, 0, 0), (0.01, 0.01, 0.2), [LOWER, (2, 20, 20, *SCANNING), STAND]),
    "off-centre": ((NEAR + 0.02, 0.04, 0), (0.01, 0.01, 0.2), [LOWER, (5, 4, 4, *SCANNING), STAND]),
    "grasp": (
        (NEAR + 0.02, 0, 0), (0.01, 0.012, 0.2),
        [(3.5, 0, 0, LOW, 0, 0), (4, 2, 2, LOW, 0, 0), (1, 0, 0, LOW, 0, 1), (3.5, 0, 0, *LIFTING),
         (2, -8, -8, *LIFTING), (3, -6, 6, *LIFTING), (1, 0, 0, *LIFTING)],
    ),
    "sweep": ((0.12, 0.09, 0.3), (0.01, 0.01, 0.3), [LOWER, (4, -4, 4, *SCANNING), STAND]),
    "stop": ((NEAR + 0.08, 0, 0), (0.02, 0.02, 0.2), [LOWER, (1, 60, 60, *SCANNING), STAND]),
}  # fmt: skip
COLUMNS = ("cube mm", "cube deg", "robot mm", "robot, way mm", "alignment mm")


def main():
    """Measure, print the table, and save it if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()

    rows = []
    print("Differences to the reference: median / 90 % quantile / largest")
    head = "".join(f"{title:>22}" for title in COLUMNS)
    print(f"{'':11}{'substeps':>9}{head}{'held differs':>14}{'µs a world-step':>17}")
    for name, scenario in SCENARIOS.items():
        for row in compare(*scenario, options.worlds):
            rows.append({"scenario": name, **row})
            cells = "".join(
                f"{' / '.join(f'{v:.2f}' for v in row.get(c, ())):>22}" for c in COLUMNS
            )
            print(f"{name:11}{row['substeps']:>9}{cells}{row['held']:14.2f}{row['us']:17.0f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def compare(cube, spread, log, n):
    """Yield a row of the table for each count of substeps, from `n` worlds."""
    cubes = cube + np.random.default_rng(0).uniform(-1, 1, (n, 3)) * spread
    params = {count: replace(P, wheel_noise=0.0, substeps=count) for count in (*COUNTS, REFERENCE)}
    params["noise"] = replace(P, substeps=REFERENCE)
    rivals = {name: PlaneVectorEnv(n, given) for name, given in params.items()}
    took, way = ({name: [] for name in rivals} for _ in range(2))
    for worlds in rivals.values():
        worlds.reset(seed=0, options={"cube": cubes})
    for seconds, left, right, *hand in log:
        actions = np.tile([left * P.motor_unit, right * P.motor_unit, *hand], (n, 1))
        for _ in range(round(seconds / P.control_period)):
            for name, worlds in rivals.items():
                start = time.perf_counter()
                worlds.step(actions)
                took[name].append(time.perf_counter() - start)
                way[name].append(worlds.pose.robot[:, :2].copy())
    truth, true_way = rivals.pop(REFERENCE), way[REFERENCE]
    for name, worlds in rivals.items():
        cube, robot = (getattr(worlds.pose, k) - getattr(truth.pose, k) for k in ("cube", "robot"))
        apart = {
            "cube mm": 1e3 * np.hypot(*cube.T[:2]),
            "cube deg": np.abs(np.rad2deg(cube[:, 2])),
            "robot mm": 1e3 * np.hypot(*robot.T[:2]),
            "robot, way mm": 1e3 * np.linalg.norm(np.subtract(way[name], true_way), axis=2).max(0),
            "alignment mm": 1e3 * np.abs(worlds.alignment_error - truth.alignment_error),
        }
        apart = {key: v[np.isfinite(v)] for key, v in apart.items()}  # no grasp, no alignment
        yield {
            "substeps": name,
            **{key: np.quantile(v, [0.5, 0.9, 1]).tolist() for key, v in apart.items() if len(v)},
            "held": float(np.mean(worlds.held != truth.held)),
            "us": 1e6 * float(np.median(took[name])) / n,
        }


if __name__ == "__main__":
    main()
