"""`jaxreplay show DIR`: print the table of a study."""

import argparse

from jaxreplay.cli.arguments import Commands, add_folder, opened


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "show", help="print the table of a study", description="Print the table of a study."
    )
    add_folder(parser)
    parser.set_defaults(action=_show)


def _show(options: argparse.Namespace) -> None:
    from jaxreplay.figures.table import table

    print(table(opened(options.folder)))
