import dataclasses
import tomllib

import jax
import matplotlib.image
import numpy as np
import pytest
from recordings_helpers import gradient_compiled_quickly, walks

from jaxreplay import Params, Records, cli
from jaxreplay.recordings.optimise import SCORES
from jaxreplay.recordings.scores import default_params, leave_one_out


@pytest.fixture(scope="module", autouse=True)
def quickly():
    with gradient_compiled_quickly():
        yield


@pytest.fixture(scope="module")
def records():
    return Records.from_sequences(*walks())


@pytest.mark.parametrize("score", SCORES)
def test_tune_prints_and_saves(tmp_path, records, capsys, score):
    path = tmp_path / "walks.npz"
    records.save(path)
    given = ["--jump", "own_tau", "--steps", "4", "--score", score]
    assert cli.main(["tune", str(path), *given]) == 0
    printed = capsys.readouterr().out
    saved = tomllib.loads((tmp_path / "walks_own_tau.toml").read_text(encoding="utf-8"))
    assert list(saved) == ["theta_i", "theta_tau", "sigma"]
    assert list(saved["sigma"]) == ["z0", "z1"]
    assert matplotlib.image.imread(tmp_path / "walks_own_tau.png").std() > 0

    start = default_params(records)
    tuned = Params(saved["theta_i"], saved["theta_tau"], list(saved["sigma"].values()))
    five = jax.tree.map(lambda *x: np.stack(x), start, tuned, tuned, tuned, tuned)
    scores = jax.tree.map(lambda x: x[:2], leave_one_out(records, five, "own_tau"))
    if score == "commands":
        assert scores.command_error[1] < scores.command_error[0]
    else:
        assert scores.log_evidence[1] > scores.log_evidence[0]
    for name, want in (
        ("log evidence", scores.log_evidence),
        ("command error", 100 * scores.command_error),
    ):
        row = next(line for line in printed.splitlines() if line.startswith(name))
        assert [float(x) for x in row.split()[2:4]] == pytest.approx(want, rel=1e-3)
    (optimised,) = (row for row in printed.splitlines() if row.endswith("(optimised)"))
    assert optimised.startswith({"commands": "command error", "evidence": "log evidence"}[score])
    assert printed.endswith(f'jr.Params.load("{path.with_name("walks_own_tau.toml")}")\n')
    loaded = Params.load(tmp_path / "walks_own_tau.toml")
    jax.tree.map(np.testing.assert_array_equal, loaded, tuned)


@pytest.mark.parametrize(
    ("kept", "arguments", "message"),
    [
        (1, [], "one.npz: one record cannot be left out: there is only 1; at least 2 are needed"),
        (2, [], "one.npz: no command ever changes in the records: there is none to predict"),
        (0, [], "no records file"),
        (None, [], "does not contain records"),
        (2, ["--out", "here.txt"], "here.txt: give a file whose name ends in .toml"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, records, capsys, kept, arguments, message):
    path = tmp_path / "one.npz"
    if kept is None:
        path.write_text("no")
    elif kept:
        still = dataclasses.replace(records, commands=0 * records.commands)
        (still if kept == 2 else records).subset(range(kept)).save(path)
    assert cli.main(["tune", str(path), *arguments]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
