"""Repeat the comparison of controllers with other sets of demonstrations: one set for each seed.

`python experiments/seeds.py [--seeds N] [--workers N]`: runs `rivals.toml` in the default world
with N seeds, at fewer positions, and prints each controller's successes by seed. The interval in
`rivals.toml`'s own table is of the runs alone: it says nothing about another set of demonstrations.
"""

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from jaxreplay import run_study
from jaxreplay.figures.table import short
from jaxreplay.machine import keep_compiled
from jaxreplay.study.config import load_config
from jaxreplay.study.workers import local_workers

STUDY = Path(__file__).with_name("rivals.toml")
CHANGES = [
    "track_bias=0.12",
    "positions.x.linspace=[0.26,0.39,10]",
    "positions.y.linspace=[-0.09,0.09,6]",
]


def main():
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--workers", type=int)
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="as of `jaxreplay run`"
    )
    parser.add_argument("--out", type=Path, default=Path("results/seeds"))
    options = parser.parse_args()
    keep_compiled()
    workers = partial(local_workers, options.workers) if options.workers else None
    studies = []
    for seed in range(1, options.seeds + 1):
        config = load_config(STUDY, [*CHANGES, f"seed={seed}", *options.set])
        studies.append(run_study(config, options.out / f"{seed}", workers=workers))
    print(table(studies))


def table(studies: list[xr.Dataset]) -> str:
    """Return a row for each controller: S in percent, by seed, then mean, lowest and highest."""
    lines = ["controller".rjust(16) + "".join(f"{s:>6}" for s in range(1, len(studies) + 1))]
    lines[0] += f"{'mean':>8}{'range':>12}   S, % of {studies[0].outcome.isel(controller=0).size}"
    for k, name in enumerate(studies[0].controller.values):
        won = np.array([100 * np.mean(s.outcome.isel(controller=k).values == "S") for s in studies])
        lines.append(short(name).rjust(16) + "".join(f"{w:6.0f}" for w in won))
        lines[-1] += f"{won.mean():8.0f}{f'{won.min():.0f}–{won.max():.0f}':>12}"
    return "\n".join(lines)


if __name__ == "__main__":
    main()
