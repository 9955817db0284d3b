"""`jaxreplay tune RECORDS`: choose parameters from records alone."""

import argparse
import json
import os
from pathlib import Path

from jaxreplay.cli.arguments import Commands, add_recordings, count, first_of, recordings
from jaxreplay.errors import ConfigError


def add_to(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "tune",
        help="choose parameters from records alone",
        description="Leave each record out in turn, filter it with the others, and follow the "
        "gradient of the score. Prints and saves the parameters, and draws a figure of the "
        "parameters after each step, with the scores after some. The file that it saves is read by "
        "jaxreplay.Params.load.",
    )
    add_recordings(parser)
    parser.add_argument(
        "--jump",
        choices=("same_tau", "own_tau"),
        default="own_tau",
        help="where a jump to another record lands: same_tau (equation 6 as printed: τ is kept) or "
        "own_tau (each record keeps its own distribution over τ) (default: own_tau)",
    )
    parser.add_argument(
        "--score",
        choices=("commands", "evidence"),
        default="commands",
        help="what to improve: the error of predicted commands (default), or the log evidence of "
        "the observations, which means little where a sensor repeats values exactly",
    )
    parser.add_argument(
        "--steps", type=count, default=30, metavar="N", help="optimisation steps (default: 30)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="a .toml; the figure is saved beside it as .png (default: RECORDS_JUMP.toml beside "
        "the first RECORDS)",
    )
    parser.set_defaults(action=_tune)


def _tune(options: argparse.Namespace) -> None:
    # XLA logs as an error that compiling takes long, which is usual here. It reads the level once.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from tqdm import tqdm

    from jaxreplay.figures.tuning import tuning_figure
    from jaxreplay.machine import keep_compiled
    from jaxreplay.recordings.tune import save, summary, tune

    keep_compiled()
    source = first_of(options)
    path = options.out or source.with_name(f"{source.stem}_{options.jump}.toml")
    if path.suffix != ".toml" or path.is_dir():
        raise ConfigError(f"--out {path}: give a file whose name ends in .toml")
    records = recordings(options)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tqdm(unit="step", disable=None) as bar:

        def progress(what: str, done: int, total: int) -> None:
            bar.set_description(what, refresh=False)
            bar.total = total
            bar.update(done - bar.n)

        try:
            tuned = tune(
                records,
                jump=options.jump,
                score=options.score,
                steps=options.steps,
                progress=progress,
            )
        except ValueError as error:
            raise ConfigError(f"{source}: {error}") from None
    print(summary(records, tuned))
    save(records, tuned, source, path)
    tuning_figure(records, tuned).savefig(path.with_suffix(".png"))
    print(f"{path}: the parameters; {path.with_suffix('.png')}: the figure")
    name = json.dumps(str(path), ensure_ascii=False)
    print(f"In Python, with `import jaxreplay as jr`: jr.Params.load({name})")
