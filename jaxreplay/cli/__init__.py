"""The command line: `jaxreplay COMMAND`, one module for each command.

A user's mistake is reported in one line on stderr (after the usage, if an argument is wrong), with
status 2, before any work is done. Modules import slow packages (JAX, xarray, Matplotlib) only when
their command runs.
"""

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from io import TextIOWrapper

from jaxreplay.cli import explore, inspect, list, new, plot, run, show, tune, watch
from jaxreplay.errors import ConfigError

DONE, MISTAKE = 0, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, and return the exit status."""
    # Better a table with ? for θ, where the encoding has none, than no table.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    if "" not in sys.path:
        sys.path.append("")  # the current folder, for a user's own controller or environment
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.action is None:
        parser.print_help()
        return DONE
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            options.action(options)
            return DONE
    except ConfigError as error:
        print(f"jaxreplay: {error}", file=sys.stderr)
        return MISTAKE
    except BrokenPipeError:  # the reader of the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"jaxreplay: {where}{error.strerror or error}", file=sys.stderr)
        return MISTAKE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="jaxreplay",
        description="Replay recorded demonstrations with a Bayesian filter: run parameter studies "
        "in simulation, inspect recordings, tune θ_I, θ_τ and σ.",
    )
    parser.add_argument("--version", action=_Version)
    parser.set_defaults(action=None)
    commands = parser.add_subparsers(metavar="command")
    for command in (new, run, list, show, plot, watch, explore, tune, inspect):
        command.add_to(commands)
    return parser


class _Version(argparse.Action):
    """Print the installed version, which is looked up only when asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str):
        super().__init__(option_strings, dest, nargs=0, help="print the version")

    def __call__(self, parser: argparse.ArgumentParser, *_) -> None:
        from importlib.metadata import version

        print(f"jaxreplay {version('jaxreplay')}")
        parser.exit(DONE)


def _warn(message: Warning | str, *_) -> None:
    print(f"jaxreplay: {message}", file=sys.stderr)
