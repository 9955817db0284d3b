"""`jaxreplay watch`: do one run of a study again, and save an animation of it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from jaxreplay.cli.arguments import Commands, opened, speed
from jaxreplay.errors import ConfigError

if TYPE_CHECKING:
    import xarray as xr


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "watch",
        help="save an animation of one run",
        description="Do one run of a study again, and save an animation of it.",
    )
    parser.add_argument(
        "study", type=Path, metavar="CONFIG_OR_DIR", help="a TOML file, or the folder of a study"
    )
    parser.add_argument(
        "--run",
        default="0",
        metavar="RUN",
        help="index of the run from 0, in the order of the file's axes, then positions, then "
        "repeats; or, of a folder, the first with an outcome (S, Fs, Fg, Fb) or a stall (fixed, "
        "cyclic, slow)",
    )
    parser.add_argument("--speed", type=speed, default=4.0, help="times real time (default: 4)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="a .gif, or a .png for a still of the end (default: run_RUN.gif in the study's "
        "folder; for a TOML file: in results/NAME)",
    )
    parser.set_defaults(action=_watch)


def _watch(options: argparse.Namespace) -> None:
    from tqdm import tqdm

    from jaxreplay.figures.animation import animate, title
    from jaxreplay.machine import keep_compiled
    from jaxreplay.study.again import run_again
    from jaxreplay.study.config import load_config
    from jaxreplay.study.demonstrations import demonstrations
    from jaxreplay.study.open import config_of
    from jaxreplay.study.runs import runs_of
    from jaxreplay.study.store import check_format

    keep_compiled()
    if options.study.is_dir():
        folder, dataset = options.study, opened(options.study)
        check_format(folder)  # a run of another format would be another run
        config = config_of(dataset)
    else:
        folder, dataset = Path("results") / options.study.stem, None
        config = load_config(options.study)
    k = _number(options.run, len(runs_of(config)), dataset)
    path = options.out or folder / f"run_{options.run}.gif"
    if path.suffix not in (".gif", ".png"):
        raise ConfigError(f"--out {path}: its name must end in .gif, or in .png for a still")
    path.parent.mkdir(parents=True, exist_ok=True)
    run = run_again(config, demonstrations(config, folder), k)
    with tqdm(desc=f"{path}", unit="frame", disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        animate(run, path, options.speed, progress)
    print(title(run))
    print(path)


def _number(run: str, total: int, dataset: "xr.Dataset | None") -> int:
    """Return the number of the run that `--run` names."""
    import numpy as np

    from jaxreplay.study.dataset import OUTCOMES, STALLS

    if run.isdecimal():
        if int(run) >= total:
            raise ConfigError(f"--run {run}: the study has {total} runs; give 0 to {total - 1}")
        return int(run)
    if run not in (*OUTCOMES, *STALLS):
        names = ", ".join((*OUTCOMES, *STALLS))
        raise ConfigError(f"--run {run}: give a run's number, or one of {names}")
    if dataset is None:
        raise ConfigError(f"--run {run}: a TOML file has no outcomes yet; give a study's folder")
    found = np.flatnonzero((dataset.outcome.values == run) | (dataset.stall.values == run))
    if len(found) == 0:
        raise ConfigError(f"--run {run}: no run of this study ended so")
    return int(found[0])
