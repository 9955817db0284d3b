import tomllib

import numpy as np
import pytest
from recordings_helpers import TUNED_LENGTHS, walks

from jaxreplay import Params, Records
from jaxreplay.recordings.scores import Scores, sensor_span
from jaxreplay.recordings.tune import Tuned, save, summary


@pytest.fixture
def records():
    return Records.from_sequences(*walks())


def tuned(records, score, evidence=(1.0, 3.0, 2.0), error=(0.2, 0.3, 0.1)):
    """An optimisation of 4 steps, scored at 3 of them; σ ends at its least and at its most."""
    shares = np.geomspace([0.1, 0.1], [1e-3, 10.0], 5)
    path = Params(np.linspace(0.1, 0.3, 5), np.full(5, 0.05), shares * sensor_span(records))
    each = np.zeros((3, 3))
    scores = Scores(np.array(evidence), np.array(error), each, each, np.array(TUNED_LENGTHS))
    return Tuned(path, np.array([0, 2, 4]), scores, "own_tau", score)


@pytest.mark.parametrize(("score", "best", "theta_i"), [("commands", 2, 0.3), ("evidence", 1, 0.2)])
def test_the_best_checkpoint_is_of_the_optimised_score(tmp_path, records, score, best, theta_i):
    result, path = tuned(records, score), tmp_path / "tuned.toml"
    assert result.best == best
    assert float(result.params(best).theta_i) == pytest.approx(theta_i)
    save(records, result, tmp_path / 'a "b".npz', path)
    saved = tomllib.loads(path.read_text(encoding="utf-8"))
    want = result.params(best)
    assert np.float32(saved["theta_i"]) == want.theta_i
    assert np.float32(saved["theta_tau"]) == want.theta_tau
    np.testing.assert_array_equal(np.array(list(saved["sigma"].values()), np.float32), want.sigma)


def test_the_summary_says_where_a_bound_was_reached(records):
    lines = summary(records, tuned(records, "commands")).splitlines()
    assert lines[0].split() == ["start", "tuned"]
    assert lines[3].startswith("σ z0")
    assert lines[3].endswith("the lowest allowed")
    assert lines[4].endswith("the highest allowed")
    assert lines[5].split()[:4] == ["log", "evidence", "1", "2"]
    assert lines[6].split()[:4] == ["command", "error", "20", "10"]
    assert len(lines) == 7


def test_the_summary_warns_where_commands_got_worse(records):
    lines = summary(records, tuned(records, "evidence")).splitlines()
    assert lines[-1].startswith("Commands are predicted worse than at the start")


def test_a_parameter_without_effect_is_named(tmp_path, records):
    sensors, commands = records.sequences()
    still = [np.column_stack([z[:, 0], np.full(len(z), 3.0)]) for z in sensors[:2]]
    two = Records.from_sequences(still, commands[:2])
    result, path = tuned(two, "commands"), tmp_path / "tuned.toml"
    lines = summary(two, result).splitlines()
    assert lines[1].endswith("no effect: leaving one of 2 records out leaves one, with no jump")
    assert lines[4].endswith("no effect on the commands: the sensor never changes")
    save(two, result, tmp_path / "two.npz", path)
    text = path.read_text(encoding="utf-8")
    assert text.count("# no effect") == 2
    assert list(tomllib.loads(text)["sigma"]) == ["z0", "z1"]
    assert "no effect" not in summary(records, tuned(records, "commands"))
    assert "the sensor never changes" not in summary(two, tuned(two, "evidence"))
