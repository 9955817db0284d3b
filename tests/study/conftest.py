"""A study in an environment, shared by several files of tests."""

import numpy as np
import pytest
from line_world import LINE
from study_helpers import write

import jaxreplay as jr


@pytest.fixture
def line(tmp_path):
    """The file of a study on a line, with two demonstrations that end at rest beyond its goal."""
    steps = np.hstack([np.full(12, 0.1), np.zeros(20)])[:, None]
    x = np.cumsum(steps, axis=0)
    sensors = [np.hstack([at, np.full_like(at, 7.0)]) for at in (x, x + 0.005)]
    jr.Records.from_sequences(sensors, [steps, steps], ["x", "seven"], ["dx"]).save(
        tmp_path / "line.npz"
    )
    return write(tmp_path, LINE, "line.toml")
