import numpy as np
import pytest
from study_helpers import made_up_study, write

from jaxreplay import open_study
from jaxreplay.figures.comparison import comparison
from jaxreplay.figures.draw import draw
from jaxreplay.figures.table import wilson

TEXT = """
theta_i = 0.1
[axis]
track_bias = [0.1, 0.0, 0.05]
controller = ["filter", "tape", "nearest"]
"""


def test_lines_tell_the_share_of_successes_with_its_interval(tmp_path):
    made_up_study(write(tmp_path, TEXT), tmp_path / "study")
    dataset = open_study(tmp_path / "study")
    (axes,) = comparison(dataset).axes
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["filter", "tape", "nearest"]
    assert len(axes.containers) == 3
    for k, bars in enumerate(axes.containers):
        line, _, (whiskers,) = bars.lines
        x, y = line.get_data()
        np.testing.assert_allclose(x, [0, 0.05, 0.1], atol=0.005)
        segments = zip((0.0, 0.05, 0.1), whiskers.get_segments(), strict=True)
        for i, (bias, (start, end)) in enumerate(segments):
            runs = dataset.sel(track_bias=bias).isel(controller=k).outcome.values
            won = int((runs == "S").sum())
            assert y[i] == pytest.approx(100 * won / runs.size)
            low, high = wilson(won, runs.size)
            assert (start[1], end[1]) == pytest.approx((100 * low, 100 * high))


def test_it_is_the_figure_of_a_study_of_controllers_against_a_number(tmp_path):
    made_up_study(write(tmp_path, TEXT), tmp_path / "study")
    dataset = open_study(tmp_path / "study")
    assert draw(dataset, tmp_path) == "comparison.png and comparison.pdf"
    two = dataset.isel(controller=slice(2))
    assert "outcomes.png" in draw(two, tmp_path)
