"""Results that a study gave when RESULTS_FORMAT was last raised, against what it gives now.

On one kind of processor results are equal bit for bit. Another may round differently, which the
closed loop amplifies: its beginning is compared tightly and its end loosely.

`python tests/study/test_golden.py` writes golden.json anew.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxreplay.loop import tracker
from jaxreplay.plane.positions import DEMONSTRATED, TESTED
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.demonstrations import record
from jaxreplay.study.runs import runs_of, settings_of, shard_size, shards_of, taught_by
from jaxreplay.study.shard import replays_of
from jaxreplay.study.store import RESULTS_FORMAT
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS

FILE = Path(__file__).with_name("golden.json")
ROWS = 100  # at the beginning of demonstrations and runs
STORED = (0, 19)  # demonstrations whose rows are stored; of the others the lengths
TOLERANCE = {
    "observations": {"atol": 1e-3},
    "demonstrations": {"atol": 1e-3},
    "log_evidence": {"rtol": 1e-3},
    "durations": {"atol": 5},  # s
    "lengths": {"atol": 50},  # rows, which are 0.1 s
}


def config():
    """2 positions × both readings of a jump, all of which succeed."""
    fixed = {name: factor.default for name, factor in FACTORS.items() if name != "jump"}
    positions = tuple(map(tuple, TESTED[[1, 2]].tolist()))
    axes = {"jump": ("same_tau", "own_tau")}
    return StudyConfig(axes, fixed | {"theta_i": 0.001}, positions=positions, repeats=1, seed=4)


def computed():
    """The results of the study now, as plain lists."""
    study = config()
    runs = runs_of(study)
    robot = taught_by(study, runs, 0)
    records = record(robot, DEMONSTRATED, study.seed)
    demonstrated = [np.hstack(pair)[:ROWS] for pair in zip(*records.sequences(), strict=True)]
    observations = np.zeros((len(runs), ROWS, records.n_sensors))
    log_evidence, duration = np.zeros((2, len(runs)))
    outcome = np.zeros(len(runs), "<U2")
    for which in shards_of(study, runs, shard_size(study)):

        def progress(so_far, which=which):
            going = so_far.steps <= ROWS
            log_evidence[which[going]] = so_far.log_evidence[going]

        some = range(len(which))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(tracker, "WINDOWS", ())  # to compile less; the results are the same
            replays = replays_of(study, {robot: records}, runs.of(which), some, progress)
        observations[which] = [replays.observations[k][:ROWS] for k in some]
        outcome[which] = study.world.outcome(replays)
        duration[which] = replays.steps * study.world.step
    return {
        "format": RESULTS_FORMAT,
        "seeds": settings_of(study, {robot: records}, runs)[1],
        "demonstrations": np.stack([demonstrated[i] for i in STORED]).round(5).tolist(),
        "lengths": np.asarray(records.lengths).tolist(),
        "observations": observations.round(5).tolist(),
        "log_evidence": log_evidence.round(3).tolist(),
        "outcomes": outcome.tolist(),
        "durations": duration.round(1).tolist(),
    }


def changed(golden, now):
    """The names of results that differ by more than another processor explains."""
    return [
        name
        for name in golden
        if not (
            np.allclose(golden[name], now[name], **({"rtol": 0, "atol": 0} | TOLERANCE[name]))
            if name in TOLERANCE
            else golden[name] == now[name]
        )
    ]


def test_a_study_gives_the_results_of_its_format():
    golden = json.loads(FILE.read_text())
    assert golden["format"] == RESULTS_FORMAT, (
        f"{FILE.name} is of RESULTS_FORMAT {golden['format']}; write it anew: "
        "python tests/study/test_golden.py"
    )
    assert golden["outcomes"] == ["S"] * 4  # so that the whole of a run is guarded
    differ = changed(golden, computed())
    assert not differ, (
        f"the results of studies changed: {', '.join(differ)}. If that is intended, raise "
        "RESULTS_FORMAT in jaxreplay/study/store.py, so that no old study is continued, and write "
        "the golden results anew: python tests/study/test_golden.py"
    )


@pytest.mark.parametrize("name", ["seeds", "outcomes", *TOLERANCE])
def test_a_change_of_each_result_is_found(name):
    golden = json.loads(FILE.read_text())
    assert changed(golden, golden) == []
    if name in TOLERANCE:
        within, beyond = (np.array(golden[name], float) for _ in range(2))
        last = np.unravel_index(-1 % within.size, within.shape)
        limit = TOLERANCE[name].get("atol", TOLERANCE[name].get("rtol", 0) * abs(within[last]))
        within[last] += 0.9 * limit
        beyond[last] += 1.1 * limit
        assert changed(golden, golden | {name: within}) == []
    else:
        beyond = [*golden[name][:-1], "Fs" if name == "outcomes" else golden[name][-1] + 1]
    assert changed(golden, golden | {name: beyond}) == [name]


def write():
    """Write the golden results, unless results of the same format changed."""
    now = computed()
    if FILE.exists() and (golden := json.loads(FILE.read_text()))["format"] == RESULTS_FORMAT:
        differ = changed(golden, now)
        if differ:
            sys.exit(
                f"the results of format {RESULTS_FORMAT} changed: {', '.join(differ)}; if that is "
                "intended, raise RESULTS_FORMAT in jaxreplay/study/store.py first"
            )
    lines = [f"{json.dumps(name)}: {json.dumps(result)}" for name, result in now.items()]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    write()
