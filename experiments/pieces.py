"""From how many records is a run pieced together, and when in the run does it switch?

    python experiments/pieces.py [--set KEY=VALUE]… [--out results/pieces]

The paper believes that a large θ_I does best "because our training runs essentially differ at the
beginning": a run can pick the record that fits, and jump on to others later. So the runs of its
Figure 3 are done again, under `own_tau` unless another reading is set; the record followed at each
step is the most probable one, p(I_t | Z_1:t). A piece is a stretch of at least a second that
follows one record. The table lists, for each θ_I, the pieces a run has, the records they come from,
and how the switches between pieces are distributed over the run; the figure adds how far
demonstrations differ, over the share of them that has passed. Intervals are 95 %, by bootstrap
over runs.
"""

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import bootstrap

from jaxreplay.figures.outcomes import tick_text
from jaxreplay.filter import build_filter
from jaxreplay.machine import keep_compiled
from jaxreplay.params import Params
from jaxreplay.plane.params import SENSOR_NAMES, SENSOR_RANGES, PlaneParams
from jaxreplay.records import Records
from jaxreplay.study.config import SLOTS, StudyConfig, load_config
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.runs import records_of, runs_of, settings_of, shards_of
from jaxreplay.study.shard import replays_of

STUDY = Path(__file__).with_name("theta_i.toml")
PIECE = 1.0  # s
THIRDS = 3


def main():
    """Run, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="as of `jaxreplay run`"
    )
    parser.add_argument("--out", type=Path, default=Path("results/pieces"))
    options = parser.parse_args()
    keep_compiled()
    options.out.mkdir(parents=True, exist_ok=True)
    config = load_config(STUDY, ["jump=own_tau", *options.set])
    runs = runs_of(config)
    won, pieces = np.zeros(len(runs), bool), [np.zeros((0, 3))] * len(runs)
    for k, run in enumerate(done_again(config, options.out), 1):
        won[run.index] = run.outcome == "S"
        record = followed(run.records, run.params, config.fixed["jump"], run.observations)
        pieces[run.index] = pieces_of(record)
        if k % SLOTS == 0 or k == len(runs):
            print(f"{k} of {len(runs)} runs", flush=True)
    theta_i = runs.values["theta_i"]
    print(table(theta_i, won, pieces))
    for suffix in ("png", "pdf"):
        figure(theta_i, won, pieces, run.records, options.out / f"pieces.{suffix}")
    print(f"{options.out}: pieces.png and pieces.pdf")


class Done(NamedTuple):
    """A run that was done again.

    Attributes:
        index: in the study.
        outcome: as in the study.
        records: those that it replayed.
        params: its parameters.
        observations: `[T, n_s]`.
    """

    index: int
    outcome: str
    records: Records
    params: Params
    observations: np.ndarray


def done_again(config: StudyConfig, folder: Path) -> Iterator[Done]:
    """Do all runs of a study again; its demonstrations are stored in `folder`."""
    robots, runs = demonstrations(config, folder), runs_of(config)
    for which in shards_of(config, runs, SLOTS):
        ours = runs.of(which)
        replays = replays_of(config, robots, ours, range(len(ours)))
        params, *_ = settings_of(config, robots, ours)
        records, outcome = records_of(config, robots, ours), config.world.outcome(replays)
        for k, run in enumerate(which.tolist()):
            its = jax.tree.map(lambda x, k=k: x[k], params)
            yield Done(run, outcome[k], records, its, np.array(replays.observations[k]))


def followed(records: Records, params: Params, jump: str, seen: np.ndarray) -> np.ndarray:
    """Return the most probable record after each observation, `[T]`."""
    return np.asarray(_followed(records, params, padded(records, seen), jump))[: len(seen)]


def padded(records: Records, seen: np.ndarray) -> jax.Array:
    """Return a run's observations, centred, and NaN after it.

    They have one shape, so that one program serves all runs.
    """
    filled = np.full((PlaneParams().max_steps, seen.shape[1]), np.nan)
    filled[: len(seen)] = records.centre(seen)
    return jnp.asarray(filled)


@partial(jax.jit, static_argnames="jump")
def _followed(records, params, z, jump):
    filter = build_filter(jump)

    def step(belief, z):
        belief, _ = filter.update(records, params, filter.predict(records, params, belief), z)
        return belief, jnp.argmax(filter.posterior(records, belief).sum(axis=1))

    return jax.lax.scan(step, filter.init(records), z)[1]


def pieces_of(record: np.ndarray) -> np.ndarray:
    """Return a run's pieces, `[n, 3]`: record, and begin and end as shares of the run."""
    starts = np.flatnonzero(np.diff(record, prepend=-1))
    ends = np.append(starts[1:], len(record))
    long = ends - starts >= round(PIECE / PlaneParams().control_period)
    rows = np.column_stack([record[starts], starts / len(record), ends / len(record)])[long]
    again = np.flatnonzero(np.diff(rows[:, 0], prepend=-1))  # with less than a piece between them
    return rows[again]


def switches_of(pieces: np.ndarray) -> np.ndarray:
    """Return when the run goes from one piece to the next, as shares of it."""
    return pieces[1:, 1]


def mean_and_interval(values: np.ndarray) -> tuple[float, float, float]:
    """Return the mean with its 95 % interval by bootstrap; NaN as interval of a single value."""
    if len(values) < 2:
        return float(values.mean()), np.nan, np.nan
    interval = bootstrap(
        (values,), np.mean, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return float(values.mean()), float(interval.low), float(interval.high)


def table(theta_i: np.ndarray, won: np.ndarray, pieces: list[np.ndarray]) -> str:
    """Return the table: a row for each θ_I."""
    lines = [
        f"{'θ_I':>9}{'runs':>6}{'S':>6}{'pieces a run':>22}{'records a run':>22}"
        f"{'switches in the first, second, last third':>44}"
    ]
    for value in dict.fromkeys(theta_i):
        these = np.flatnonzero(theta_i == value)
        row = f"{value:9.3g}{len(these):6d}{won[these].sum():6d}"
        for count in (len, lambda p: len(set(p[:, 0]))):
            mean, low, high = mean_and_interval(np.array([count(pieces[k]) for k in these]))
            row += f"{mean:.1f} [{low:.1f}, {high:.1f}]".rjust(22)
        when = np.concatenate([switches_of(pieces[k]) for k in these])
        thirds = np.histogram(when, np.linspace(0, 1, THIRDS + 1))[0] / max(len(when), 1)
        lines.append(row + ", ".join(f"{share:.0%}" for share in thirds).rjust(44))
    return "\n".join(lines)


def figure(theta_i, won, pieces, records: Records, path: Path):
    """Draw pieces against θ_I, switches over the run, and how demonstrations differ."""
    values = list(dict.fromkeys(theta_i))
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        drawn, (left, middle, right) = plt.subplots(1, 3, figsize=(8, 2.7), layout="constrained")
        for name, which, style in (("S", won, "o-"), ("not S", ~won, "s--")):
            counts = [
                np.array([len(pieces[k]) for k in np.flatnonzero((theta_i == v) & which)])
                for v in values
            ]
            means = [mean_and_interval(c) if len(c) else (np.nan,) * 3 for c in counts]
            mean, low, high = np.array(means).T
            left.errorbar(
                range(len(values)), mean, [mean - low, high - mean], fmt=style, capsize=2,
                color="black" if name == "S" else "0.55", label=name, markersize=4,
            )  # fmt: skip
        left.set_xticks(range(len(values)), [tick_text("theta_i", v) for v in values], rotation=90)
        left.set_xlabel("$\\theta_I$")
        left.set_ylabel("pieces a run (mean, 95 %)")
        left.set_ylim(0, 1.1 * max(map(len, pieces)))
        left.legend(frameon=False)
        when = [switches_of(p) for p in pieces]
        middle.hist(100 * np.concatenate(when), np.linspace(0, 100, 21), color="0.4")
        middle.set_xlabel("when in the run, % of its duration")
        middle.set_ylabel("switches, all runs")
        spread = spreads(records)
        at = np.linspace(0, 100, spread.shape[1])
        right.plot(at, spread[0], "k-", label=SENSOR_NAMES[0])
        right.plot(at, spread[1:].mean(axis=0), "k--", label="proximeters' mean")
        right.set_xlabel("share of the demonstration that has passed, %")
        right.set_ylabel("spread of demonstrations,\nshare of a sensor's range")
        right.set_ylim(0, None)
        right.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2)
        drawn.savefig(path, dpi=150)
        plt.close(drawn)


def spreads(records: Records) -> np.ndarray:
    """Return the standard deviation over records at the same share of each, `[n_s, 101]`."""
    at = [
        rows[np.linspace(0, len(rows) - 1, 101).round().astype(int)]
        for rows in records.sequences()[0]
    ]
    return (np.std(at, axis=0) / np.array(SENSOR_RANGES)).T


if __name__ == "__main__":
    main()
