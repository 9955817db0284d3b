"""`jaxreplay run FILE`: run a study, print its table and draw its figures."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from jaxreplay.cli.arguments import Commands, address, count, seconds
from jaxreplay.cli.new import check_file
from jaxreplay.cli.stop import leave_sigint_to_that_thread, note_on_stop
from jaxreplay.errors import ConfigError

if TYPE_CHECKING:
    from jaxreplay.study.config import StudyConfig
    from jaxreplay.study.run import RunEach


_CERTIFICATES = {
    "ca": "certificate of the authority",
    "cert": "certificate of this client",
    "key": "private key of this client",
}


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "run",
        help="run a study and draw its figures",
        description="Run the study that a TOML file describes, print its table and draw its "
        "figures. After it was stopped, the same command continues it.",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="e.g. experiments/theta_i.toml")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for demonstrations, results and figures (default: results/ and FILE's name)",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=count, metavar="N", help="run in N processes on this machine"
    )
    where.add_argument(
        "--scheduler",
        type=address,
        metavar="ADDRESS",
        help="run on the workers of this Dask scheduler, such as tcp://10.0.0.1:8786",
    )
    for name, what in _CERTIFICATES.items():
        parser.add_argument(
            f"--tls-{name}",
            type=Path,
            metavar="FILE",
            help=f"{what}, for a scheduler at tls://… (default: of Dask's configuration)",
        )
    parser.add_argument(
        "--patience",
        type=seconds,
        default=60.0,
        metavar="SECONDS",
        help="give up after this time without any worker (default: 60)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="changes",
        metavar="KEY=VALUE",
        help="use this value instead of FILE's, e.g. 'axis.theta_i.logspace=[-1,-3,5]' or "
        "jump=own_tau; a single value takes the place of FILE's axis",
    )
    parser.add_argument(
        "--params",
        type=Path,
        metavar="TUNED",
        help="take θ_I, θ_τ and σ from a file saved by jaxreplay tune",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="only print the number of runs, and estimate time and memory",
    )
    parser.set_defaults(action=_run)


def _run(options: argparse.Namespace) -> None:
    from jaxreplay.figures.draw import draw
    from jaxreplay.figures.table import table
    from jaxreplay.machine import keep_compiled
    from jaxreplay.study.config import load_config
    from jaxreplay.study.run import run_study
    from jaxreplay.study.runs import runs_of, shard_size, shards_of
    from jaxreplay.study.store import check_format

    check_file(options.file)
    _check_certificates(options)
    keep_compiled()
    config = load_config(options.file, options.changes, options.params)
    folder = options.out or Path("results") / options.file.stem
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"--out {folder} is a file; give a folder")
    check_format(folder)
    runs = runs_of(config)
    shards = len(shards_of(config, runs, shard_size(config)))
    note_on_stop("finished shards are kept; run the same command again to continue")
    print(f"{folder}: {_count(len(runs), 'run')} in {_count(shards, 'shard')}", file=sys.stderr)
    if options.dry_run:
        print(_cost(config, folder, len(runs), options), file=sys.stderr)
        return
    with _workers(options) as workers:
        dataset = run_study(config, folder, workers=workers)
    print(table(dataset), flush=True)  # drawing takes seconds
    print(f"{folder}: the study, {draw(dataset, folder)}")


def _check_certificates(options: argparse.Namespace) -> None:
    """Check that all three files of certificates are given, or none, and exist.

    Raises:
        ConfigError: they are not.
    """
    given = {name: getattr(options, f"tls_{name}") for name in _CERTIFICATES}
    if not any(given.values()):
        return
    if options.scheduler is None:
        raise ConfigError("--tls-ca, --tls-cert and --tls-key are for a --scheduler")
    for name, path in given.items():
        if path is None:
            raise ConfigError(f"--tls-{name} is missing: all of --tls-ca, --tls-cert, --tls-key")
        if not path.is_file():
            raise ConfigError(f"--tls-{name} {path}: there is no such file")


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n > 1)}"


def _cost(config: "StudyConfig", folder: Path, runs: int, options: argparse.Namespace) -> str:
    """Return a line on the time and memory that a study will take, measured on a few runs.

    The workers of a scheduler are unknown, so with one it gives only the time of a run.
    """
    from jaxreplay.machine import cores
    from jaxreplay.study.cost import SAMPLE, estimate
    from jaxreplay.study.demonstrations import demonstrations

    print(f"measuring {_count(min(SAMPLE, runs), 'run')}", file=sys.stderr)
    with TemporaryDirectory() as elsewhere:
        place = folder if folder.exists() else Path(elsewhere)
        cost = estimate(config, demonstrations(config, place))
    if options.scheduler:
        return f"about {cost.seconds:.2f} s a run on one core of this machine"
    n = min(options.workers or cores(), cores())
    time = runs * cost.seconds / n
    told = f"{time / 60:.1f} min" if time > 60 else f"{max(time, 1):.0f} s"
    return (
        f"about {told} on {_count(n, 'core')} ({cost.seconds:.2f} s a run on one), "
        f"{cost.memory / 2**30:.1f} GiB{' a worker' if options.workers else ''}"
    )


@contextmanager
def _workers(
    options: argparse.Namespace,
) -> "Iterator[Callable[[], AbstractContextManager[RunEach]] | None]":
    """Yield a function that opens workers to run shards in; None: they run in this process.

    A scheduler is connected to at once, so that a mistake is reported before any work is done.
    """
    if options.scheduler:
        from jaxreplay.study.workers import Certificates, workers_of

        files = [getattr(options, f"tls_{name}") for name in _CERTIFICATES]
        certificates = Certificates(*files) if any(files) else None
        with workers_of(options.scheduler, certificates, options.patience) as run_each:
            yield lambda: nullcontext(run_each)
    elif options.workers:
        from multiprocessing import resource_tracker

        from jaxreplay.study.workers import local_workers

        # Once for all, as it unblocks SIGINT in the thread from which it is started.
        resource_tracker.ensure_running()
        leave_sigint_to_that_thread()
        yield partial(local_workers, options.workers, options.patience)
    else:
        yield None
