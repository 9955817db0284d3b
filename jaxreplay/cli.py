"""The command line: thin, and without tracebacks for a user's mistake."""

import argparse
import sys
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path

import numpy as np
from tqdm import tqdm

from jaxreplay.config import ConfigError, load_config
from jaxreplay.figures import figure_3
from jaxreplay.plane.demonstrator import TESTED
from jaxreplay.plane.params import PlaneParams
from jaxreplay.replay import OUTCOMES
from jaxreplay.study import DATASET, run_study, table

DONE, MISTAKE, INTERRUPTED = 0, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="jaxreplay",
        description="How far does a robot get by replaying demonstrations? Studies of θ_I, θ_τ, σ.",
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    run = commands.add_parser(
        "run",
        help="run a study and draw its figure",
        description="Run the study a TOML file describes, print its table and draw its figure.",
    )
    run.add_argument("file", type=Path, metavar="FILE", help="e.g. experiments/theta_i.toml")
    run.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="for demonstrations, dataset and figure (default: results/ and FILE's name)",
    )
    run.set_defaults(action=_run)
    options = parser.parse_args(arguments)
    # A table in an encoding without θ is better than none.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        return options.action(options)
    except ConfigError as error:
        print(f"jaxreplay: {error}", file=sys.stderr)
        return MISTAKE
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"jaxreplay: {where}{error.strerror or error}", file=sys.stderr)
        return MISTAKE
    except KeyboardInterrupt:
        print("\njaxreplay: interrupted", file=sys.stderr)
        return INTERRUPTED


def _run(options: argparse.Namespace) -> int:
    config = load_config(options.file)
    folder = options.out or Path("results") / options.file.stem
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"--out {folder} is a file; give a folder")
    runs = len(config.theta_i) * len(TESTED) * config.repeats
    print(f"{folder}: {runs} runs for each of {', '.join(config.jump)}", file=sys.stderr)
    dataset = run_study(config, folder, _Progress())
    for suffix in ("png", "pdf"):
        figure_3(dataset, folder / f"figure_3.{suffix}")
    print(table(dataset))
    print(f"{folder / DATASET}, figure_3.png and figure_3.pdf beside it")
    return DONE


class _Progress:
    """A line for each reading of a jump: kept up to date on a terminal, else told at its end."""

    def __init__(self):
        self._steps = PlaneParams().max_steps
        self._bars: dict[str, tqdm] = {}

    def __call__(self, jump: str, step: int, outcome: np.ndarray):
        if jump not in self._bars:
            self._bars[jump] = tqdm(
                total=self._steps,
                bar_format="{desc}: at most {total} steps, {n} done [{elapsed}]{postfix}",
                desc=jump,
                disable=None,
            )
        bar = self._bars[jump]
        going = np.sum(outcome == "")
        counts = ", ".join(f"{name} {np.sum(outcome == name)}" for name in OUTCOMES)
        bar.set_postfix_str(f"{counts}, going {going}", refresh=False)
        bar.update()
        if going == 0:
            bar.close()
            if bar.disable:
                print(f"{jump}: {step} steps, {counts}", file=sys.stderr)
