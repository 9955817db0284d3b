"""`jaxreplay list [DIR]`: list the studies below a folder."""

import argparse
from pathlib import Path

from jaxreplay.cli.arguments import Commands
from jaxreplay.errors import ConfigError


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "list",
        help="list the studies below a folder",
        description="List the studies below a folder: runs done, success rate with Wilson's 95 % "
        "interval, and the number of values along each axis.",
    )
    parser.add_argument(
        "folder",
        type=Path,
        nargs="?",
        default=Path("results"),
        metavar="DIR",
        help="(default: results)",
    )
    parser.set_defaults(action=_list)


def _list(options: argparse.Namespace) -> None:
    if not options.folder.is_dir():
        raise ConfigError(f"{options.folder}: there is no such folder; give that of your results")
    folders = sorted(manifest.parent for manifest in options.folder.rglob("study.json"))
    if not folders:
        raise ConfigError(f"{options.folder}: contains no study; jaxreplay run makes one")
    rows = [("study", "runs", "S, %", "axes"), *map(_row, folders)]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    for study, runs, success, axes in rows:
        line = f"{study:<{widths[0]}}  {runs:>{widths[1]}}  {success:>{widths[2]}}  {axes}"
        print(line.rstrip())


def _row(folder: Path) -> tuple[str, str, str, str]:
    """Return a study's folder, runs done, success rate and axes; or why it cannot be read."""
    import numpy as np

    from jaxreplay.figures.table import rate
    from jaxreplay.study.dataset import axes_of
    from jaxreplay.study.open import open_study

    try:
        dataset = open_study(folder)
    except ValueError as error:
        return str(folder), "–", "–", str(error)
    outcome = dataset.outcome.values
    done = int(np.sum(outcome != ""))
    runs = f"{done}" if done == outcome.size else f"{done} of {outcome.size}"
    axes = ", ".join(f"{name} × {dataset.sizes[name]}" for name in axes_of(dataset))
    return str(folder), runs, rate(int(np.sum(outcome == "S")), done), axes or "–"
