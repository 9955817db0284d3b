"""`jaxreplay new [NAME]`: list the packaged experiments, or write one into the current folder."""

import argparse
import difflib
import sys
from importlib.resources import files
from pathlib import Path
from textwrap import fill

from jaxreplay.cli.arguments import Commands
from jaxreplay.errors import ConfigError, suggest
from jaxreplay.machine import write_whole


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "new",
        help="list the packaged experiments, or copy one to be changed and run",
        description="List the packaged experiments and the question that each asks. With NAME, "
        "write that experiment into the current folder, to be changed and run.",
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="e.g. theta_i")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="where to write it (default: NAME.toml)"
    )
    parser.set_defaults(action=_new)


def packaged() -> dict[str, str]:
    """Return the text of each packaged experiment by name, in alphabetical order."""
    folder = files("jaxreplay.experiments")
    found = sorted(
        (file for file in folder.iterdir() if file.name.endswith(".toml")),
        key=lambda file: file.name,
    )
    return {file.name.removesuffix(".toml"): file.read_text("utf-8") for file in found}


def question(text: str) -> str:
    """Return the question that an experiment asks: the comment at the head of its file."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    return " ".join(lines)


def check_file(path: Path) -> None:
    """Raise an error if a study's file is missing; it names the command that makes one."""
    if not path.exists():
        near = difflib.get_close_matches(path.stem, packaged(), n=1, cutoff=0.8) or ["NAME"]
        raise ConfigError(
            f"{path}: there is no such file; jaxreplay new {near[0]} writes one, and jaxreplay new "
            "lists them all"
        )


def _new(options: argparse.Namespace) -> None:
    experiments = packaged()
    if options.name is None:
        if options.out:
            raise ConfigError("--out: give the NAME of an experiment, too")
        for name, text in experiments.items():
            indent = "    "
            print(name)
            print(fill(question(text), 96, initial_indent=indent, subsequent_indent=indent))
        print("\njaxreplay new NAME writes NAME.toml here; jaxreplay run NAME.toml runs it")
        return
    name = options.name.removesuffix(".toml")
    if name not in experiments:
        raise ConfigError(f"there is no experiment {suggest(name, experiments)}")
    path = options.out or Path(f"{name}.toml")
    if path.exists():
        raise ConfigError(f"{path} exists; give another name as --out FILE")
    write_whole(path, experiments[name].encode())
    print(f"{path}: {question(experiments[name])}", file=sys.stderr)
    print(f"jaxreplay run {path}")
