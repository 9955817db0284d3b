"""Findings on orientations: angles that wrap, and quaternions that change sign."""

import numpy as np

from jaxreplay.recordings.findings.finding import Column, Finding, measured, others

# An angle wraps where it steps by a full turn less at most an eighth, while its range is a turn and
# all its other steps are below an eighth.
TURNS, WRAP = {2 * np.pi: "2π", 360.0: "360"}, 1 / 8
WRAP_RANGE = 1.001  # turns; a sensor whose range is wider is no angle that wraps
# Signs flip together where at least 3 sensors change sign, each by more than 4 times its median
# step (of those that are not 0) while its absolute value changes by less than a tenth of that.
FLIPPING, FLIP, FLIP_KEPT = 3, 4, 0.1


def wraps(
    rows: list[np.ndarray], k: int, column: Column
) -> tuple[list[Finding], set[tuple[int, int]]]:
    """Find where an angle wraps; return the finding, and record and row of each such step."""
    for turn, name in TURNS.items():
        if not (1 - WRAP) * turn <= column.highest - column.lowest <= WRAP_RANGE * turn:
            continue
        steps = [np.abs(np.nan_to_num(np.diff(r[:, k]))) for r in rows]
        far = [d >= (1 - WRAP) * turn for d in steps]
        near = np.concatenate([d[~f] for d, f in zip(steps, far, strict=True)])
        at = [(i, int(t) + 1) for i, f in enumerate(far) for t in np.flatnonzero(f)]
        if at and near.size and 0 < near.max() <= WRAP * turn:
            i, t = at[0]
            finding = Finding(
                f"sensor {column.name} steps by {steps[i][t - 1]:.4g} at record {i}, row {t}"
                f"{others(at)}, about {name}: an angle that wraps, which the filter takes for far "
                "apart on both sides; record its cosine and sine instead",
                tuple(sorted({j for j, _ in at})),
                k,
                at[0],
            )
            return [finding], set(at)
    return [], set()


def flips(
    rows: list[np.ndarray], columns: list[Column]
) -> tuple[list[Finding], dict[int, set[tuple[int, int]]]]:
    """Find where sensors change sign together; return the finding, and those steps by column."""
    sensors = [k for k, column in enumerate(columns) if column.kind == "sensor"]
    steps = [np.abs(np.diff(r[:, sensors], axis=0)) for r in rows]
    usual = np.array([_median_nonzero(d) for d in np.concatenate(steps).T])
    cases: dict[int, set[tuple[int, int]]] = {}
    for i, (r, d) in enumerate(zip(rows, steps, strict=True)):
        z = r[:, sensors]
        kept = np.abs(np.diff(np.abs(z), axis=0)) < FLIP_KEPT * d
        flip = (z[1:] * z[:-1] < 0) & kept & (d > FLIP * usual)
        for t in np.flatnonzero(flip.sum(axis=1) >= FLIPPING):
            for s in np.flatnonzero(flip[t]):
                cases.setdefault(sensors[s], set()).add((i, int(t) + 1))
    if not cases:
        return [], {}
    at = sorted(set.union(*cases.values()))
    i, t = at[0]
    names = ", ".join(columns[k].name for k in sorted(cases))
    return [
        Finding(
            f"sensors {names} change sign together at record {i}, row {t}{others(at)}: a "
            "quaternion? keep one sign in all rows, as q and −q are the same rotation",
            tuple(sorted({j for j, _ in at})),
            min(k for k in cases if at[0] in cases[k]),
            at[0],
        )
    ], cases


def _median_nonzero(steps: np.ndarray) -> float:
    steps = measured(steps)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else np.inf
