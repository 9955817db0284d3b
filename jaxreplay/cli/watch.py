"""`jaxreplay watch`: do one run of a study again, and save a page that plays it."""

import argparse
import re
import tomllib
from pathlib import Path
from typing import Any

from jaxreplay.cli.arguments import Commands, speed
from jaxreplay.cli.new import check_file
from jaxreplay.errors import ConfigError


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "watch",
        help="save a page that plays one run",
        description="Do one run of a study again, and save a page that plays it.",
    )
    parser.add_argument(
        "study", type=Path, metavar="CONFIG_OR_DIR", help="a TOML file, or the folder of a study"
    )
    parser.add_argument(
        "--run",
        default="0",
        metavar="RUN",
        help="values of factors, position and repeat, separated by commas, such as "
        "jump=own_tau,theta_i=0.01,position=0,repeat=2: those not given are free, and the first "
        "run that fits is taken; or the run's index from 0, in the order of the file's axes, then "
        "positions, then repeats; or, of a folder, the first run with an outcome (S, Fs, …) or "
        "a stall (fixed, cyclic, slow)",
    )
    parser.add_argument("--speed", type=speed, default=4.0, help="times real time (default: 4)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="a page (.html), an animation (.gif) or a picture of the end (.png); default: "
        "run_RUN.html in the study's folder, for a TOML file in results/NAME",
    )
    parser.set_defaults(action=_watch)


def _watch(options: argparse.Namespace) -> None:
    from tqdm import tqdm

    from jaxreplay.figures.animation import title
    from jaxreplay.machine import keep_compiled
    from jaxreplay.pictures import Watched, check_suffix
    from jaxreplay.study.again import find_and_run_again
    from jaxreplay.study.config import load_config

    check_file(options.study)
    keep_compiled()
    if options.out:
        check_suffix(options.out)
    if options.study.is_dir():
        study = folder = options.study
    else:
        study, folder = load_config(options.study), Path("results") / options.study.stem
    named = parse_run(options.run)
    k, run = find_and_run_again(study, named, folder)
    path = options.out or folder / f"run_{k if isinstance(named, dict) else named}.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    with tqdm(desc=f"{path}", unit="frame", disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        Watched(run, options.speed).save(path, progress)
    print(title(run))
    print(path)


def parse_run(text: str) -> int | str | dict[str, Any]:
    """Return what `--run` names a run by: an index, a word, or values by name.

    The values of `"jump=own_tau,theta_i=0.01"` are read as in a study's file; what is not TOML
    there is a word without its quotes.

    Raises:
        ConfigError: a part is not NAME=VALUE, or parts are not separated by commas.
    """
    if text.isdecimal():
        return int(text)
    if "=" not in text:
        return text
    named = {}
    for part in re.split(r",(?=\s*\w+\s*=)", text):  # not the commas of a list
        name, equals, value = part.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise ConfigError(f"--run {text}: give NAME=VALUE, such as theta_i=0.01,position=0")
        try:
            named[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            if re.search(r"\w\s*=", value):
                raise ConfigError(
                    f"--run {text}: separate values by commas, such as position=0,repeat=0"
                ) from None
            named[name.strip()] = value.strip()
    return named
