"""`jaxreplay explore`: a page in the browser that shows a study, runs what is asked, and drives."""

import argparse
from pathlib import Path

from jaxreplay.cli.arguments import Commands, opened


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "explore",
        help="see a study, ask for runs and demonstrate by hand, in a browser",
        description="Open a page in the browser: the cells of a study and its runs; runs with "
        "other parameters, while they are computed; demonstrations by hand. It is served to this "
        "machine alone, at an address that nobody else knows, until this command is ended.",
    )
    parser.add_argument(
        "study", type=Path, nargs="?", metavar="DIR",
        help="the folder of a study; without it, runs of the default study can be asked for",
    )  # fmt: skip
    parser.add_argument("--port", type=_port, default=0, help="default: any that is free")
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
    parser.set_defaults(action=_explore)


def _port(text: str) -> int:
    """Read a port's number."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"must be a whole number up to 65535; got {text}")
    return int(text)


def _explore(options: argparse.Namespace) -> None:
    import webbrowser

    from jaxreplay.explore.server import serve

    if options.study is not None:
        from jaxreplay.study.store import check_format

        opened(options.study)
        check_format(options.study)

    def ready(address: str) -> None:
        print(address, flush=True)
        if not options.no_browser:
            webbrowser.open(address)

    serve(options.study, options.port, ready)
