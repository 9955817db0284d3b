"""The command line: thin, and without tracebacks for a user's mistake."""

import argparse
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from tqdm import tqdm

from jaxreplay.config import ConfigError, StudyConfig, load_config, tuned_changes
from jaxreplay.filter import PREDICTIONS
from jaxreplay.machine import cores, keep_compiled
from jaxreplay.maps import draw
from jaxreplay.runs import runs_of, shards_of
from jaxreplay.study import (
    OUTCOMES,
    STALLS,
    config_of,
    demonstrations,
    loaded,
    open_study,
    run_study,
    shard_size,
)
from jaxreplay.table import table

if TYPE_CHECKING:
    from jaxreplay.workers import RunEach

DONE, MISTAKE, INTERRUPTED = 0, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="jaxreplay",
        description="How far does a robot get by replaying demonstrations? Studies of θ_I, θ_τ, σ.",
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    run = commands.add_parser(
        "run",
        help="run a study and draw its figure",
        description="Run the study a TOML file describes, print its table and draw its figure. "
        "Given again after it was stopped, it goes on.",
    )
    run.add_argument("file", type=Path, metavar="FILE", help="e.g. experiments/theta_i.toml")
    run.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="for demonstrations, dataset and figure (default: results/ and FILE's name)",
    )
    where = run.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=_count, metavar="N", help="run shards in N processes on this machine"
    )
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="run shards on the workers of this Dask scheduler"
    )
    run.add_argument(
        "--set",
        action="append",
        default=[],
        dest="changes",
        metavar="KEY=VALUE",
        help="instead of what FILE says, e.g. 'axis.theta_i.logspace=[-1,-3,5]' or jump=own_tau; a "
        "single value takes the place of FILE's axis",
    )
    run.add_argument(
        "--params", type=Path, metavar="TUNED", help="a file that tune saved: its θ_I, θ_τ and σ"
    )
    run.add_argument(
        "--slots", type=_count, metavar="N", help="runs that advance together, as --set slots=N"
    )
    run.add_argument(
        "--dry-run", action="store_true", help="only tell its size, and measure what it will cost"
    )
    run.set_defaults(action=_run)
    for name, action, what in (
        ("show", _show, "print the table of a study"),
        ("plot", _plot, "draw the figure of a study"),
    ):
        command = commands.add_parser(name, help=what, description=f"{what.capitalize()}.")
        command.add_argument("folder", type=Path, metavar="DIR", help="what run was given as --out")
        command.set_defaults(action=action)
    watch = commands.add_parser(
        "watch",
        help="write an animation of one run",
        description="Do one run of a study again and write an animation of it.",
    )
    watch.add_argument(
        "study", type=Path, metavar="CONFIG_OR_RESULT", help="a TOML file, or the folder of a study"
    )
    watch.add_argument(
        "--run",
        default="0",
        metavar="RUN",
        help="its number, counted along the dataset's axes from 0; or, of a folder, the first "
        f"with an outcome ({', '.join(OUTCOMES)}) or a stall ({', '.join(STALLS)})",
    )
    watch.add_argument("--speed", type=_speed, default=4.0, help="times real time (default: 4)")
    watch.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="a .gif, or a .png for a still of the end (default: run_RUN.gif beside the data)",
    )
    watch.set_defaults(action=_watch)
    tune = commands.add_parser(
        "tune",
        help="choose parameters from records alone",
        description="Leave each record out in turn, filter it with the others, and follow the "
        "gradient of how well its commands are predicted. Prints and saves the parameters, and "
        "draws the curve.",
    )
    tune.add_argument("records", type=Path, metavar="RECORDS", help="an .npz file of records")
    tune.add_argument("--jump", choices=PREDICTIONS, default="same_tau", help="reading of a jump")
    tune.add_argument(
        "--score",
        choices=("commands", "evidence"),
        default="commands",
        help="what to better: the error of predicted commands, or the log evidence of what was "
        "observed, which means little where a sensor repeats values exactly",
    )
    tune.add_argument("--steps", type=_count, default=30, metavar="N", help="(default: 30)")
    tune.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="a .toml; the curve is put beside it as .png (default: beside RECORDS)",
    )
    tune.set_defaults(action=_tune)
    inspect = commands.add_parser(
        "inspect",
        help="tell and draw what recordings hold",
        description="Tell and draw what recordings hold, and what in them is worth a look.",
    )
    inspect.add_argument("records", type=Path, metavar="RECORDS", help="a .npz of Records.save")
    inspect.add_argument(
        "--out", type=Path, metavar="FILE", help="the figure (default: RECORDS, but .png)"
    )
    inspect.set_defaults(action=_inspect)
    options = parser.parse_args(arguments)
    # A table in an encoding without θ is better than none.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    keep_compiled()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            return options.action(options)
    except ConfigError as error:
        print(f"jaxreplay: {error}", file=sys.stderr)
        return MISTAKE
    except BrokenPipeError:  # what read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"jaxreplay: {where}{error.strerror or error}", file=sys.stderr)
        return MISTAKE
    except KeyboardInterrupt:
        print("\njaxreplay: interrupted", file=sys.stderr)
        return INTERRUPTED


def _warn(message: Warning | str, *_):
    print(f"jaxreplay: {message}", file=sys.stderr)


def _run(options: argparse.Namespace) -> int:
    slots = [f"slots={options.slots}"] if options.slots else []
    tuned = tuned_changes(options.params) if options.params else []
    config = load_config(options.file, tuned + options.changes + slots)
    folder = options.out or Path("results") / options.file.stem
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"--out {folder} is a file; give a folder")
    runs = runs_of(config)
    shards = len(shards_of(runs, shard_size(config)))
    print(f"{folder}: {len(runs)} runs in {shards} shard{'s' * (shards > 1)}", file=sys.stderr)
    if options.dry_run:
        print(_cost(config, folder, len(runs), options.workers), file=sys.stderr)
        return DONE
    try:
        with _workers(options) as workers:
            dataset = run_study(config, folder, _Progress(len(runs)), workers)
    except KeyboardInterrupt:
        print(
            "\njaxreplay: interrupted; finished shards are kept, the same command goes on",
            file=sys.stderr,
        )
        return INTERRUPTED
    drawn = draw(dataset, folder)
    print(table(dataset))
    print(f"{folder}: the study, {drawn}")
    return DONE


def _cost(config: StudyConfig, folder: Path, runs: int, workers: int | None) -> str:
    from jaxreplay.estimate import SAMPLE, estimate

    print(f"measuring, on {SAMPLE} of them", file=sys.stderr)
    with TemporaryDirectory() as elsewhere:
        place = folder if folder.exists() else Path(elsewhere)
        cost = estimate(config, demonstrations(config, place))
    n = min(workers or cores(), cores())
    minutes = runs * cost.seconds / n / 60
    return (
        f"about {minutes:.1f} min on {n} core{'s' * (n > 1)} ({cost.seconds:.2f} s a run on one), "
        f"{cost.memory / 2**30:.1f} GiB{' a worker' if workers else ''}"
    )


@contextmanager
def _workers(
    options: argparse.Namespace,
) -> "Iterator[Callable[[], AbstractContextManager[RunEach]] | None]":
    """What opens the processes to run shards in; None is in this one.

    A scheduler is reached at once, for what is wrong there to be told before any work is done.
    """
    if options.scheduler:
        from jaxreplay.workers import workers_of

        with workers_of(options.scheduler) as run_each:
            yield lambda: nullcontext(run_each)
    elif options.workers:
        from jaxreplay.workers import local_workers

        yield partial(local_workers, options.workers)
    else:
        yield None


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more; got {text}")
    return int(text)


def _show(options: argparse.Namespace) -> int:
    print(table(_opened(options.folder)))
    return DONE


def _plot(options: argparse.Namespace) -> int:
    print(f"{options.folder}: {draw(_opened(options.folder), options.folder)}")
    return DONE


def _opened(folder: Path) -> xr.Dataset:
    try:
        dataset = open_study(folder)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    missing = int((dataset.outcome == "").sum())
    if missing:
        print(f"{folder}: {missing} of {dataset.outcome.size} runs are missing", file=sys.stderr)
    return dataset


def _speed(text: str) -> float:
    speed = float(text)
    if not 0.1 <= speed <= 1000:
        raise argparse.ArgumentTypeError(f"must be in [0.1, 1000]; got {text}")
    return speed


def _watch(options: argparse.Namespace) -> int:
    from jaxreplay.watch import animate_run

    if options.study.is_dir():
        folder, dataset = options.study, _opened(options.study)
        config = config_of(dataset)
    else:
        folder, dataset = Path("results") / options.study.stem, None
        config = load_config(options.study)
    k = _chosen(options.run, len(runs_of(config)), dataset)
    path = options.out or folder / f"run_{options.run}.gif"
    if path.suffix not in (".gif", ".png"):
        raise ConfigError(f"--out {path}: let its name end in .gif, or in .png for a still")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tqdm(desc=f"{path}", unit="frame", disable=None) as bar:

        def progress(done: int, total: int):
            bar.total = total
            bar.update(done - bar.n)

        print(animate_run(config, demonstrations(config, folder), k, path, options.speed, progress))
    print(path)
    return DONE


def _inspect(options: argparse.Namespace) -> int:
    from jaxreplay.inspection import inspect, report
    from jaxreplay.inspection_figure import FORMATS, inspection_figure

    path = options.out or options.records.with_suffix(".png")
    if path.suffix[1:] not in FORMATS or path == options.records:
        raise ConfigError(f"--out {path}: let its name end in one of .{', .'.join(FORMATS)}")
    records = loaded(options.records)
    path.parent.mkdir(parents=True, exist_ok=True)
    inspection = inspect(records)
    print(report(inspection))
    inspection_figure(records, inspection, path)
    print(path)
    return DONE


def _chosen(run: str, total: int, dataset: xr.Dataset | None) -> int:
    """The number of the run that was asked for."""
    if run.isdecimal():
        if int(run) >= total:
            raise ConfigError(f"--run {run}: the study has {total} runs; give 0 to {total - 1}")
        return int(run)
    if run not in (*OUTCOMES, *STALLS):
        known = ", ".join((*OUTCOMES, *STALLS))
        raise ConfigError(f"--run {run}: give a run's number, or one of {known}")
    if dataset is None:
        raise ConfigError(f"--run {run}: how runs ended is known once they are run; give a folder")
    found = np.flatnonzero((dataset.outcome.values == run) | (dataset.stall.values == run))
    if len(found) == 0:
        raise ConfigError(f"--run {run}: no run of this study ended so")
    return int(found[0])


def _tune(options: argparse.Namespace) -> int:
    from jaxreplay.tuned import draw, text, tune, write
    from jaxreplay.tuning import usual

    path = options.out or options.records.with_name(f"{options.records.stem}_{options.jump}.toml")
    if path.suffix != ".toml" or path.is_dir():
        raise ConfigError(f"--out {path}: give a file whose name ends in .toml")
    records = loaded(options.records)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tqdm(unit="step", disable=None) as bar:

        def progress(what: str, done: int, total: int):
            bar.set_description(what, refresh=False)
            bar.total = total
            bar.update(done - bar.n)

        try:
            tuned = tune(
                records, usual(records), options.jump, options.score, options.steps, progress
            )
        except ValueError as error:
            raise ConfigError(f"{options.records}: {error}") from None
    print(text(records, tuned))
    write(records, tuned, options.records, path)
    draw(records, tuned, path.with_suffix(".png"))
    print(f"{path}: the parameters; {path.with_suffix('.png')}: the curve")
    return DONE


class _Progress:
    """A line kept up to date on a terminal; else one whenever a tenth more of the runs is done."""

    def __init__(self, total: int):
        self._total, self._began, self._told = total, None, 0
        self._bar = tqdm(
            total=total,
            bar_format="{n} of {total} runs [{elapsed}<{remaining}]{postfix}",
            disable=None,
        )

    def __call__(self, outcome: np.ndarray, duration: np.ndarray):
        done = int(np.sum(outcome != ""))
        simulated, now = float(duration.sum()), time.monotonic()
        if self._began is None:  # what was done in an earlier sitting counts as done, but not here
            self._began = now, simulated
            self._bar.initial, self._told = done, 10 * done // self._total
        since, already = self._began
        counts = ", ".join(f"{name} {np.sum(outcome == name)}" for name in OUTCOMES)
        rate = (simulated - already) / max(now - since, 1e-9)
        told = f"{counts}; {rate:.0f} simulated s a second"
        self._bar.n = done
        self._bar.set_postfix_str(told, refresh=False)
        self._bar.update(0)
        if self._bar.disable and 10 * done // self._total > self._told:
            self._told = 10 * done // self._total
            left = (now - since) * (self._total - done) / max(done - self._bar.initial, 1)
            print(f"{done} of {self._total} runs: {told}, {left:.0f} s left", file=sys.stderr)
        if done == self._total:
            self._bar.close()
