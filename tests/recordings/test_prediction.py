import numpy as np
import pytest
from recordings_helpers import sequences

from jaxreplay import Records
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.recordings.findings.prediction import predict, shifted, unlike, unpredicted
from jaxreplay.recordings.inspect import inspect
from jaxreplay.recordings.report import report
from jaxreplay.study.demonstrations import record

pytestmark = pytest.mark.usefixtures("fewer_windows")


def paths(n=6):
    """Curves at slightly different places and paces, and the velocities along them."""
    rng = np.random.default_rng(3)
    sensors, commands = [], []
    for i in range(n):
        t = np.minimum(np.arange(72 + i) / (59 + i), 1)
        a = 3 + 0.1 * rng.normal()
        sensors.append(np.stack([np.sin(a * t), 0.5 * np.cos(2 * t), t * t], 1))
        commands.append(np.stack([np.cos(a * t), -np.sin(2 * t)], 1) * (t < 1)[:, None])
    return sensors, commands


def test_ordinary_records_are_predicted():
    prediction = predict(Records.from_sequences(*paths()))
    assert prediction is not None
    assert [*unpredicted(prediction), *unlike(prediction), *shifted(prediction)] == []


@pytest.mark.parametrize("mistake", ["columns swapped", "sign flipped", "other units"])
def test_a_record_unlike_the_others_is_found(mistake):
    sensors, commands = paths()
    if mistake == "columns swapped":
        sensors[2] = sensors[2][:, [1, 2, 0]]
    elif mistake == "sign flipped":
        commands[2] = -commands[2]
    else:
        sensors[2] = sensors[2] * 57.3
    inspection = inspect(Records.from_sequences(sensors, commands), scores=True)
    about = [f for f in inspection.findings if "predict the commands far worse" in f.text]
    assert [f.records for f in about] == [(2,)]
    assert "record 2 (" in about[0].text
    unlikely = [f.records for f in inspection.findings if "far less probable" in f.text]
    assert unlikely == ([] if mistake == "sign flipped" else [(2,)])  # flipped are its commands


def reactions(late):
    """Commands that answer the noisy observation before them, or are `late` rows off that."""
    rng = np.random.default_rng(0)
    sensors, commands = [], []
    for _ in range(6):
        z, seen, sent = rng.normal(size=2), [], []
        for _ in range(72):
            seen.append(z)
            sent.append(-0.6 * z)
            z = 0.4 * z + 0.3 * rng.normal(size=2)
        # Command t follows observation t, and observation t + 1 follows it.
        sensors.append(np.array(seen)[1 - late :])
        commands.append(np.array(sent)[: len(sensors[-1])])
    return Records.from_sequences(sensors, commands)


def test_commands_beside_the_observation_that_they_answer_are_found():
    right, early = predict(reactions(0)), predict(reactions(1))
    assert right is not None
    assert early is not None
    assert list(shifted(right)) == []
    ((text, *_),) = shifted(early)
    assert text.startswith("commands seem to be one row early: moved by a row, the other records")
    assert "see Records.from_steps" in text


@pytest.mark.slow
def test_the_planes_are_predicted():
    records = record(PlaneParams(), DEMONSTRATED[:4], 1)
    inspection = inspect(records, scores=True)
    assert inspection.prediction is not None
    assert inspection.findings == []
    assert "command error" in report(inspection)


def test_two_records_are_not_scored():
    records = Records.from_sequences(*sequences((40, 50)))
    progress = []
    assert inspect(records, scores=True, progress=lambda *n: progress.append(n)).prediction is None
    assert progress == []


def test_progress_reaches_its_total():
    progress = []
    records = Records.from_sequences(*paths(3))
    predict(records, lambda *n: progress.append(n))
    done, total = np.array(progress).T
    assert (total == 3 * np.asarray(records.lengths).sum()).all()
    assert (np.diff(done) >= 0).all()
    assert done[-1] == total[-1]
