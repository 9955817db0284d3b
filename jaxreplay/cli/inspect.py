"""`jaxreplay inspect RECORDS`: summarise recordings, and name what is unusual in them."""

import argparse
from pathlib import Path

from jaxreplay.cli.arguments import Commands
from jaxreplay.errors import ConfigError


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "inspect",
        help="summarise recordings, and name what is unusual in them",
        description="Summarise recordings in a table and a figure, and name what is unusual.",
    )
    parser.add_argument(
        "records", type=Path, metavar="RECORDS", help="an .npz file of Records.save"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="the figure (default: RECORDS with the suffix .png)",
    )
    parser.set_defaults(action=_inspect)


def _inspect(options: argparse.Namespace) -> None:
    from jaxreplay.figures.inspection import FORMATS, inspection_figure
    from jaxreplay.recordings.inspect import inspect
    from jaxreplay.recordings.read import read
    from jaxreplay.recordings.report import report

    path = options.out or options.records.with_suffix(".png")
    if path.suffix[1:] not in FORMATS or path == options.records:
        raise ConfigError(f"--out {path}: its name must end in one of .{', .'.join(FORMATS)}")
    records = read(options.records)
    path.parent.mkdir(parents=True, exist_ok=True)
    inspection = inspect(records)
    print(report(inspection))
    inspection_figure(records, inspection).savefig(path)
    print(path)
