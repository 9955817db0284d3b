"""`jaxreplay inspect RECORDS`: summarise recordings, and name what is unusual in them."""

import argparse
import os
from pathlib import Path

from jaxreplay.cli.arguments import Commands, add_recordings, first_of, recordings
from jaxreplay.errors import ConfigError


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "inspect",
        help="summarise recordings, and name what is unusual in them",
        description="Summarise recordings in a table and a figure, filter each record with the "
        "others, and name what is unusual.",
    )
    add_recordings(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="the figure (default: the first RECORDS with the suffix .png)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="do not filter each record with the others, which takes some ten seconds and more",
    )
    parser.set_defaults(action=_inspect)


def _inspect(options: argparse.Namespace) -> None:
    # XLA logs as an error that compiling takes long, which is usual here. It reads the level once.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from tqdm import tqdm

    from jaxreplay.figures.inspection import FORMATS, inspection_figure
    from jaxreplay.machine import keep_compiled
    from jaxreplay.recordings.inspect import inspect
    from jaxreplay.recordings.report import report

    path = options.out or first_of(options).with_suffix(".png")
    if options.out is None and path in options.records:
        raise ConfigError(f"{path}: the figure would take its place; give --out FILE for it")
    if path.suffix[1:] not in FORMATS or path in options.records:
        raise ConfigError(f"--out {path}: its name must end in one of .{', .'.join(FORMATS)}")
    records = recordings(options)
    path.parent.mkdir(parents=True, exist_ok=True)
    if options.quick:
        inspection = inspect(records)
    else:
        keep_compiled()
        with tqdm(unit="row", desc="filtering", leave=False, disable=None) as bar:

            def progress(done: int, total: int) -> None:
                bar.total = total
                bar.update(done - bar.n)

            inspection = inspect(records, scores=True, progress=progress)
    print(report(inspection))
    inspection_figure(records, inspection).savefig(path)
    print(path)
