"""From how many records is a run pieced together, when does it switch, and what for?

    python experiments/pieces.py [--seeds 10] [--set KEY=VALUE]… [--out results/pieces]

The paper believes that a large θ_I does best "because our training runs essentially differ at the
beginning": a run can pick the record that fits, and jump on to others later. So runs of its
Figure 3 are done again with several sets of demonstrations, one for each seed, under `own_tau`
unless another reading is set; the record followed at each step is the most probable one,
p(I_t | Z_1:t). A piece is a stretch of at least a second that follows one record.

Without any jump (θ_I = 0) the most probable record changes too, as observations tell records apart.
So the table lists for each θ_I the pieces of a run, and those that the same observations have when
they are filtered with θ_I = 0; the records that pieces come from; how the switches between pieces
are distributed over the run; and, for the runs of two pieces or more, how many succeed, and how
many of the same runs when they are replayed with θ_I = 0. The figure adds how far demonstrations
differ, over the share of them that has passed. Intervals are 95 %, over sets (see `sets.py`).
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from sets import interval, number, percent

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
DEFAULTS = (
    "jump=own_tau",
    "axis.theta_i=[0.316227766017,0.1,0.0316227766017,0.01,1e-6,0]",
    "repeats=1",
    "positions.x.linspace=[0.26,0.39,2]",
    "positions.y.linspace=[-0.09,0.09,3]",
)
PIECE = 1.0  # s
THIRDS = 3


class Pieced(NamedTuple):
    """The runs with one set of demonstrations: V values of θ_I, n runs of each.

    Attributes:
        won: `[V, n]` whether they succeed.
        pieces: V × n arrays, see :func:`pieces_of`.
        without: the same, where the same observations are filtered with θ_I = 0.
        spread: `[n_s, 101]` of the demonstrations, see :func:`spreads`.
    """

    won: np.ndarray
    pieces: list[list[np.ndarray]]
    without: list[list[np.ndarray]]
    spread: np.ndarray


def main():
    """Run, print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10, help="how many sets of demonstrations")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="as of `jaxreplay run`"
    )
    parser.add_argument("--out", type=Path, default=Path("results/pieces"))
    options = parser.parse_args()
    keep_compiled()
    options.out.mkdir(parents=True, exist_ok=True)
    sets = []
    for seed in range(1, options.seeds + 1):
        config = load_config(STUDY, [*DEFAULTS, *options.set, f"seed={seed}"])
        sets.append(pieced(config, options.out))
        print(f"{seed} of {options.seeds} sets", flush=True)
    theta_i = np.array(config.values_of("theta_i"))
    print(table(theta_i, sets))
    for suffix in ("png", "pdf"):
        figure(theta_i, sets, options.out / f"pieces.{suffix}")
    print(f"{options.out}: pieces.png and pieces.pdf")


def pieced(config: StudyConfig, folder: Path) -> Pieced:
    """Do the runs of a study again, whose only axis is θ_I, and divide them into pieces."""
    won, found = np.zeros(config.n_runs, bool), [()] * config.n_runs
    for run in done_again(config, folder):
        won[run.index] = run.outcome == "S"
        found[run.index] = tuple(
            pieces_of(followed(run.records, params, config.fixed["jump"], run.observations))
            for params in (run.params, replace(run.params, theta_i=np.zeros(())))
        )
    n = config.n_runs // len(config.values_of("theta_i"))
    pieces, without = (
        [[each[k] for each in found[i : i + n]] for i in range(0, len(found), n)] for k in (0, 1)
    )
    return Pieced(won.reshape(-1, n), pieces, without, spreads(run.records))


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


def table(theta_i: np.ndarray, sets: list[Pieced]) -> str:
    """Return the table: a row for each θ_I."""
    lines = [
        f"{'':9}{'':>14}{'':>22}{'filtered':>22}{'':>22}{'switches by thirds':>24}"
        f"{'of runs with two pieces or more':>44}",
        f"{'θ_I':>9}{'S, %':>14}{'pieces a run':>22}{'with θ_I = 0':>22}{'records a run':>22}"
        f"{'of the run':>24}{'count':>8}{'S, %':>16}{'S with θ_I = 0, %':>20}",
    ]
    for v, value in enumerate(theta_i):
        won = interval(np.array([each.won[v].mean() for each in sets]))
        row = f"{value:9.3g}{percent(won):>14}"
        counts = (
            [[len(p) for p in each.pieces[v]] for each in sets],
            [[len(p) for p in each.without[v]] for each in sets],
            [[len(set(p[:, 0])) for p in each.pieces[v]] for each in sets],
        )
        row += "".join(f"{number(interval(np.mean(count, axis=1))):>22}" for count in counts)
        when = np.concatenate([switches_of(p) for each in sets for p in each.pieces[v]])
        thirds = np.histogram(when, np.linspace(0, 1, THIRDS + 1))[0] / max(len(when), 1)
        row += ", ".join(f"{share:.0%}" for share in thirds).rjust(24)
        switched = np.array(counts[0]) > 1
        row += f"{switched.sum():8}"
        alone = np.flatnonzero(theta_i == 0)
        for other in (v, *alone):
            rates = [
                each.won[other][s].mean() for each, s in zip(sets, switched, strict=True) if s.any()
            ]
            row += f"{percent(interval(np.array(rates))):>{16 if other == v else 20}}"
        lines.append(row)
    return "\n".join(lines)


def figure(theta_i: np.ndarray, sets: list[Pieced], path: Path):
    """Draw pieces against θ_I, switches over the run, and how demonstrations differ."""
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        drawn, (left, middle, right) = plt.subplots(1, 3, figsize=(8, 2.7), layout="constrained")
        for name, style, color in (("pieces", "o-", "black"), ("without", "s--", "0.55")):
            means = [
                interval(
                    np.array([np.mean([len(p) for p in getattr(each, name)[v]]) for each in sets])
                )
                for v in range(len(theta_i))
            ]
            mean, low, high = np.array(means).T
            left.errorbar(
                range(len(theta_i)), mean, [mean - low, high - mean], fmt=style, capsize=2,
                color=color, markersize=4,
                label="as replayed" if name == "pieces" else "filtered with $\\theta_I$ = 0",
            )  # fmt: skip
        left.set_xticks(
            range(len(theta_i)), [tick_text("theta_i", v) for v in theta_i], rotation=90
        )
        left.set_xlabel("$\\theta_I$")
        left.set_ylabel("pieces a run (mean, 95 % over sets)")
        left.set_ylim(0, None)
        left.legend(frameon=False)
        jumping = [runs for each in sets for runs, v in zip(each.pieces, theta_i, strict=True) if v]
        when = [switches_of(p) for runs in jumping for p in runs]
        middle.hist(100 * np.concatenate(when), np.linspace(0, 100, 21), color="0.4")
        middle.set_xlabel("when in the run, % of its duration")
        middle.set_ylabel("switches, θ_I > 0")
        spread = np.mean([each.spread for each in sets], axis=0)
        at = np.linspace(0, 100, spread.shape[1])
        right.plot(at, spread[0], "k-", label=SENSOR_NAMES[0])
        right.plot(at, spread[1:].mean(axis=0), "k--", label="proximeters' mean")
        right.set_xlabel("share of the demonstration, %")
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
