"""`jaxreplay plot DIR`: draw the figures of a study."""

import argparse

from jaxreplay.cli.arguments import Commands, add_folder, opened


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "plot",
        help="draw the figures of a study",
        description="Draw the figures of a study into its folder.",
    )
    add_folder(parser)
    parser.set_defaults(action=_plot)


def _plot(options: argparse.Namespace) -> None:
    from jaxreplay.figures.draw import draw

    print(f"{options.folder}: {draw(opened(options.folder), options.folder)}")
