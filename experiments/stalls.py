"""What does the belief look like when a replay stalls? The paper says "fixed or cyclic".

    python experiments/stalls.py STUDY… [--each 20] [--out results/stalls]

Takes finished studies, picks up to `--each` of their stalls of each kind, evenly spaced, does these
runs again and filters their observations. The table describes, for each kind, the belief in the
last 60 s: medians, with quartiles in brackets. The figure shows the run of each kind that is
nearest to the medians.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

from jaxreplay.machine import keep_compiled
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.stall import STALL_SECONDS
from jaxreplay.study.again import run_again
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import config_of, open_study
from jaxreplay.study.runs import runs_of
from jaxreplay.study.worlds.plane import STALLS

PERIOD = PlaneParams().control_period
FOLLOWED = 0.05  # p(I) above which a record counts as followed
FEATURES = {  # of a stall's last minute
    "records followed with 5 % or more": lambda s: np.sum(s.p.mean(axis=0) > FOLLOWED),
    "p of the most probable record, %": lambda s: 100 * s.p.max(axis=1).mean(),
    "changes of the most probable record": lambda s: np.sum(np.diff(s.p.argmax(axis=1)) != 0),
    "range of the mean of τ, s": lambda s: np.ptp((s.p * s.tau).sum(axis=1)),
    "mean of |track command|, motor units": lambda s: np.abs(s.units).mean(),
    "steps with both tracks rounded to 0, %": lambda s: (
        100 * (np.abs(s.units) < 0.5).all(axis=1).mean()
    ),
    "changes of the turning direction": lambda s: np.sum(np.diff(np.sign(s.units @ [-1, 1])) != 0),
}


class Stall(NamedTuple):
    """The last T steps of a run that stalled.

    Attributes:
        name: the command line's name of the run.
        p: `[T, N]` p(I).
        tau: `[T, N]` the mean of τ within each record, in s.
        units: `[T, 2]` commands of the tracks, in motor units.
    """

    name: str
    p: np.ndarray
    tau: np.ndarray
    units: np.ndarray


def main():
    """Pick runs, do them again, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", type=Path, nargs="+")
    parser.add_argument("--each", type=int, default=20, help="stalls of each kind")
    parser.add_argument("--out", type=Path, default=Path("results/stalls"))
    options = parser.parse_args()
    if options.each < 1:
        parser.error("--each must be at least 1")
    keep_compiled()
    options.out.mkdir(parents=True, exist_ok=True)
    found = {kind: [] for kind in STALLS}
    for kind, (folder, k) in picked(options.studies, options.each):
        found[kind].append(stall_of(folder, k, options.out))
        print(f"{kind}: {found[kind][-1].name}", flush=True)
    found = {kind: stalls for kind, stalls in found.items() if stalls}
    if not found:
        parser.error("no run of these studies stalled")
    print(table(found))
    for suffix in ("png", "pdf"):
        figure(found, options.out / f"stalls.{suffix}")
    print(f"{options.out}: stalls.png and stalls.pdf")


def picked(folders: list[Path], each: int) -> list[tuple[str, tuple[Path, int]]]:
    """Return kinds of stalls, each with a study and the index of a run in it."""
    all_of = {kind: [] for kind in STALLS}
    for folder in folders:
        kinds = open_study(folder).stall.values.ravel()
        for kind in STALLS:
            all_of[kind] += [(folder, int(k)) for k in np.flatnonzero(kinds == kind)]
    return [
        (kind, runs[k])
        for kind, runs in all_of.items()
        for k in np.unique(np.linspace(0, len(runs) - 1, min(each, len(runs))).astype(int))
    ]


def stall_of(folder: Path, k: int, out: Path) -> Stall:
    """Do a study's k-th run again, and return its end."""
    config = config_of(open_study(folder))
    run = run_again(config, demonstrations(config, out), k)
    belief = run.beliefs[-round(STALL_SECONDS / PERIOD) :]
    share = belief.sum(axis=2)
    moments = PERIOD * np.arange(belief.shape[2])
    return Stall(
        f"{folder} --run {k}",
        share,
        (belief @ moments) / np.maximum(share, np.finfo(share.dtype).tiny),
        run.commands[-len(belief) :, :2] / runs_of(config).values["motor_unit"][k],
    )


def features(stalls: list[Stall]) -> np.ndarray:
    """Return the features of n stalls, `[n, F]`."""
    return np.array([[feature(stall) for feature in FEATURES.values()] for stall in stalls])


def table(found: dict[str, list[Stall]]) -> str:
    """Return the table: a row for each feature, a column for each kind."""
    heads = [f"{kind} ({len(stalls)})" for kind, stalls in found.items()]
    lines = [f"{'in the last 60 s':38}" + "".join(f"{head:>24}" for head in heads)]
    quartiles = [
        np.quantile(features(stalls), (0.5, 0.25, 0.75), axis=0) for stalls in found.values()
    ]
    for k, name in enumerate(FEATURES):
        texts = ["{:.1f} [{:.1f}, {:.1f}]".format(*each[:, k]) for each in quartiles]
        lines.append(f"{name:38}" + "".join(f"{text:>24}" for text in texts))
    return "\n".join(lines)


def typical(stalls: list[Stall]) -> Stall:
    """Return the stall whose features are nearest to the medians of all."""
    values = features(stalls)
    spread = np.maximum(values.std(axis=0), 1e-9)
    return stalls[(((values - np.median(values, axis=0)) / spread) ** 2).sum(axis=1).argmin()]


def figure(found: dict[str, list[Stall]], path: Path):
    """Draw a typical stall of each kind in a column: belief, moments and commands."""
    with plt.rc_context({"font.size": 8, "axes.titlelocation": "left"}):
        drawn, axes = plt.subplots(
            3, len(found), figsize=(1 + 3 * len(found), 5.4), layout="constrained", sharex=True,
            sharey="row", squeeze=False,
        )  # fmt: skip
        for column, (kind, stalls) in zip(axes.T, found.items(), strict=True):
            stall = typical(stalls)
            time = PERIOD * np.arange(-len(stall.p), 0)
            top, middle, bottom = column
            extent = (time[0], 0, -0.5, stall.p.shape[1] - 0.5)
            top.imshow(
                stall.p.T,
                cmap="Greys",
                vmin=0,
                vmax=1,
                aspect="auto",
                origin="lower",
                extent=extent,
            )
            top.set_title(f"{kind}\n{stall.name}")
            for rank, i in enumerate(np.argsort(-stall.p.mean(axis=0))[:3]):
                part = np.where(stall.p[:, i] > FOLLOWED, stall.tau[:, i], np.nan)
                middle.plot(time, part, color=str(0.3 * rank), lw=1.5 - 0.4 * rank)
            bottom.axhspan(-0.5, 0.5, color="0.88", lw=0)
            for units, style, name in zip(
                stall.units.T, ("k-", "k--"), ("left", "right"), strict=True
            ):
                bottom.plot(time, units, style, lw=0.8, label=name)
            bottom.set_xlabel("time before the end, s")
        axes[0, 0].set_ylabel("p(I): record I")
        axes[1, 0].set_ylabel("mean of τ, s, in the 3\nmost probable records")
        axes[2, 0].set_ylabel("tracks, motor units\n(grey: rounded to 0)")
        axes[2, -1].legend(frameon=False, loc="upper right", ncols=2)
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


if __name__ == "__main__":
    main()
