"""Measure how kind a world is: its teacher, and the tape, the nearest demonstration played blindly.

`python experiments/world.py [motor_unit=0.005 …]`: for each of ten seeds, of 20 demonstrations, how
many succeed, and their median alignment error; and how many of 300 runs the tape succeeds in, for
the first seeds. The defaults of `PlaneParams` were chosen by this, see there.
"""

import argparse
from dataclasses import replace

import numpy as np

from jaxreplay import Params
from jaxreplay.loop.replay import replay
from jaxreplay.loop.rivals import controller_named
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seed_of
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED, facing
from jaxreplay.plane.teacher import demonstrate
from jaxreplay.study.demonstrations import record
from jaxreplay.study.worlds.plane import Plane

AHEAD, ASIDE = np.linspace(0.26, 0.39, 20), np.linspace(-0.09, 0.09, 15)


def main():
    """Print a line for each seed, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("constants", nargs="*", metavar="NAME=VALUE", help="of the plane")
    parser.add_argument("--seeds", type=int, default=10, help="of demonstrations")
    parser.add_argument("--tapes", type=int, default=2, help="seeds for which the tape is run")
    options = parser.parse_args()
    changes = dict(text.split("=", 1) for text in options.constants)
    plane = replace(PlaneParams(), **{name: float(value) for name, value in changes.items()})
    errors = []
    for seed in range(options.seeds):
        try:
            made = demonstrate(plane, DEMONSTRATED, seed)
        except RuntimeError as error:
            print(f"seed {seed}: {error}", flush=True)
            continue
        errors.append(1e3 * made.alignment_error)
        line = f"seed {seed}: 20 of 20, median error {np.median(errors[-1]):.1f} mm"
        if seed < options.tapes:
            line += f"; tape {np.mean(tape(plane, seed)):.0%}"
        print(line, flush=True)
    if errors:
        print(f"{len(errors)} of {options.seeds} seeds; median error {np.median(errors):.1f} mm")


def tape(plane: PlaneParams, seed: int) -> np.ndarray:
    """Return whether the tape succeeds at each of 300 positions."""
    x, y = (each.ravel() for each in np.meshgrid(AHEAD, ASIDE, indexing="ij"))
    n = len(x)
    params = Params(np.zeros(n), np.zeros(n), np.ones((n, 7)))  # the tape uses none
    seeds = [seed_of(seed, k, 0, 1) for k in range(n)]
    cubes = {"cube": facing(np.column_stack([x, y]))}
    records, env = record(plane, DEMONSTRATED, seed), PlaneVectorEnv(n, plane)
    blind = controller_named("tape")
    replays = replay(records, params, env, seeds, options=cubes, controller=blind)
    return Plane.outcome(replays) == "S"


if __name__ == "__main__":
    main()
