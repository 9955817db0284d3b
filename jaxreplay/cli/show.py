"""`jaxreplay show DIR`: print the table of a study."""

import argparse
import csv
import sys
from typing import TYPE_CHECKING

from jaxreplay.cli.arguments import Commands, add_folder, opened

if TYPE_CHECKING:
    from collections.abc import Iterator

    import xarray as xr


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "show", help="print the table of a study", description="Print the table of a study."
    )
    add_folder(parser)
    parser.add_argument(
        "--csv",
        action="store_true",
        help="print one row a run instead, as comma-separated values",
    )
    parser.set_defaults(action=_show)


def _show(options: argparse.Namespace) -> None:
    from jaxreplay.figures.table import table

    dataset = opened(options.folder)
    if options.csv:
        csv.writer(sys.stdout, lineterminator="\n").writerows(_rows(dataset))
    else:
        print(table(dataset))


def _rows(dataset: "xr.Dataset") -> "Iterator[tuple]":
    """Yield the names of the columns, then the values of each run; a missing value is empty.

    Columns are the factors that vary, position, cube_x and cube_y (m) if it has positions, repeat,
    and the variables.
    """
    import numpy as np

    from jaxreplay.study.dataset import along, axes_of

    factors = [name for dim in axes_of(dataset) for name in along(dataset, dim)]
    places = [name for name in ("position", "cube_x", "cube_y") if name in dataset.coords]
    columns = [*factors, *places, "repeat", *map(str, dataset.data_vars)]
    yield tuple(columns)
    runs = dataset.outcome
    each = [dataset[c].broadcast_like(runs).transpose(*runs.dims).values.ravel() for c in columns]
    for row in zip(*(values.tolist() for values in each), strict=True):
        yield tuple("" if isinstance(v, float) and np.isnan(v) else v for v in row)
