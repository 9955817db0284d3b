"""A study in an environment, shared by several files of tests."""

import pytest
from line_world import of_line


@pytest.fixture
def line(tmp_path):
    """The file of a study on a line, with two demonstrations that end at rest beyond its goal."""
    return of_line(tmp_path)
