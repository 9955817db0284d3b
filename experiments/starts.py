"""How soon does a belief find itself that starts in the middle of a task?

    python experiments/starts.py [--seeds 0 1 2] [--each 3]

Each of the teacher's demonstrations is left out in turn, and its observations from a row in its
middle on are filtered with the others. The command is compared with the recorded one, before its
observation is known, some time after the start: mean absolute difference as a share of the
command's range. Starts: "first" (equation 5), "anywhere", and "from the beginning", a filter that
has seen the demonstration from its first row on. Their rival has no memory: the command of the row
whose observation is nearest, each sensor divided by its range.
"""

import argparse

import jax
import numpy as np

from jaxreplay import Records
from jaxreplay.filter.options import Options, Start
from jaxreplay.loop.tracker import Tracker
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.recordings.scores import default_params, leave_out, sensor_span
from jaxreplay.records.columns import command_range
from jaxreplay.study.demonstrations import record

SECONDS = (0.1, 1.0, 3.0)
WAYS = ("from the beginning", "anywhere", "first", "nearest row")


def main():
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--each", type=int, default=3, help="starts in each demonstration")
    parser.add_argument("--of", type=int, default=len(DEMONSTRATED), help="demonstrations")
    options = parser.parse_args()
    found = {way: [] for way in WAYS}
    for seed in options.seeds:
        records = record(PlaneParams(), DEMONSTRATED[: options.of], seed)
        for i in range(records.n_records):
            for way, errors in errors_of(records, i, options.each).items():
                found[way].append(errors)
    print("error of a command, % of its range: mean ± standard error over the demonstrations")
    print(f"of {len(options.seeds)} sets, each left out in turn")
    print(f"{'after':20}" + "".join(f"{s:>14g} s" for s in SECONDS))
    for way, errors in found.items():
        of_record = 100 * np.array(errors)
        mean, spread = of_record.mean(axis=0), of_record.std(axis=0, ddof=1)
        cells = zip(mean, spread / np.sqrt(len(of_record)), strict=True)
        print(f"{way:20}" + "".join(f"{m:9.1f} ± {e:4.1f}" for m, e in cells))


def errors_of(records: Records, i: int, each: int) -> dict[str, np.ndarray]:
    """Return the errors of record i by way, `[len(SECONDS)]`, means over its starts."""
    others, (sensors, commands) = leave_out(records, i), records.sequences()
    after = np.round(np.array(SECONDS) / records.period).astype(int)
    last = len(sensors[i]) - after[-1] - 1
    starts = np.linspace(0, last, each + 2)[1:-1].astype(int)
    width = np.ptp(command_range(records.commands, records.lengths), axis=0)
    wanted = commands[i]

    def error(sent: np.ndarray, row: int) -> float:
        return float(np.mean(np.abs(sent - wanted[row])[width > 0] / width[width > 0]))

    return {
        "from the beginning": _filtered(others, sensors[i], [0] * each, starts, after, error),
        "anywhere": _filtered(others, sensors[i], starts, starts, after, error, "anywhere"),
        "first": _filtered(others, sensors[i], starts, starts, after, error),
        "nearest row": _nearest(others, sensors[i], starts, after, error),
    }


def _filtered(
    others: Records, seen: np.ndarray, begins, starts, after, error, start: Start = "first"
) -> np.ndarray:
    """Filter from the rows `begins` on; return mean errors `after` the rows `starts`."""
    n, one = len(starts), default_params(others)
    params = jax.tree.map(lambda x: np.broadcast_to(x, (n, *x.shape)), one)
    tracker = Tracker(others, params, Options(start=start))
    errors = np.zeros((n, len(after)))
    begins, ends = np.array(begins), np.array(starts) + after[-1]
    for t in range((ends - begins).max() + 1):
        row = begins + t
        for b in range(n):
            for k in np.flatnonzero(row[b] == starts[b] + after):
                errors[b, k] = error(tracker.command[b], row[b])
        going = row < ends
        tracker.observe(seen[np.minimum(row, len(seen) - 1)], going)
    return errors.mean(axis=0)


def _nearest(others: Records, seen: np.ndarray, starts, after, error) -> np.ndarray:
    """Return mean errors of the command that followed the nearest observation."""
    sensors, commands = others.sequences()
    rows = np.concatenate([s[:-1] for s in sensors])
    following = np.concatenate([u[1:] for u in commands])
    width = sensor_span(others)
    errors = [
        [
            error(following[(((rows - seen[s + a - 1]) / width) ** 2).sum(axis=1).argmin()], s + a)
            for a in after
        ]
        for s in starts
    ]
    return np.mean(errors, axis=0)


if __name__ == "__main__":
    main()
