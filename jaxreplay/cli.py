"""The command line: thin, and without tracebacks for a user's mistake."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from jaxreplay.config import ConfigError, StudyConfig, load_config
from jaxreplay.figures import figure_3
from jaxreplay.plane.params import PlaneParams
from jaxreplay.replay import OUTCOMES
from jaxreplay.study import DATASET, run_study, table

DONE, MISTAKE, INTERRUPTED = 0, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="jaxreplay", description=__doc__)
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
    try:
        return options.action(options)
    except (ConfigError, OSError) as error:
        print(f"jaxreplay: {error}", file=sys.stderr)
        return MISTAKE
    except KeyboardInterrupt:
        print("jaxreplay: interrupted", file=sys.stderr)
        return INTERRUPTED


def _run(options: argparse.Namespace) -> int:
    config = load_config(options.file)
    folder = options.out or Path("results") / options.file.stem
    dataset = run_study(config, folder, _Progress(config))
    print(table(dataset))
    for suffix in ("png", "pdf"):
        figure_3(dataset, folder / f"figure_3.{suffix}")
    print(f"{folder / DATASET}, figure_3.png and figure_3.pdf beside it")
    return DONE


class _Progress:
    """A bar for each reading of a jump, in control steps; silent where there is no terminal."""

    def __init__(self, config: StudyConfig):
        self._steps = PlaneParams().max_steps
        self._bars: dict[str, tqdm] = {}

    def __call__(self, jump: str, step: int, outcome: np.ndarray):
        if jump not in self._bars:
            self._bars[jump] = tqdm(total=self._steps, desc=jump, unit="step", disable=None)
        bar = self._bars[jump]
        counts = [f"{name} {np.sum(outcome == name)}" for name in OUTCOMES]
        going = np.sum(outcome == "")
        bar.set_postfix_str(", ".join([*counts, f"going {going}"]), refresh=False)
        bar.update()
        if going == 0:
            bar.close()
