import numpy as np
import pytest
import xarray as xr
from study_helpers import VARIABLES

from jaxreplay.figures.draw import draw
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS

KINDS = np.array(["S", "Fs", "Fg", "Fb", ""])


def about(name):
    """The attributes that a study gives a factor's coordinate."""
    factor = FACTORS[name]
    attrs = {"symbol": factor.symbol, "long_name": factor.long_name}
    return attrs | ({"units": factor.units} if factor.units else {})


def dataset(sizes, seed=0):
    """Random outcomes, some of them missing, over axes of so many values."""
    values = {"theta_i": 0.1, "theta_tau": 0.05, "sigma": 0.3, "motor_unit": 0.01}
    shape = tuple(sizes.values())
    outcome = np.random.default_rng(seed).choice(KINDS, shape)
    coords = {
        name: (name, values[name] / 2.0 ** np.arange(n), about(name))
        for name, n in sizes.items()
        if name in values
    }
    if "dithering" in sizes:
        coords["dithering"] = ("dithering", [False, True], about("dithering"))
    n = sizes["position"]
    coords |= {"cube_x": ("position", 0.2 + 0.01 * (np.arange(n) // 4))}
    coords |= {"cube_y": ("position", 0.05 * (np.arange(n) % 4 - 2))}
    both = {"alignment_error": np.ones(shape), "duration": np.ones(shape)}
    variables = {
        name: (tuple(sizes), array, VARIABLES[name])
        for name, array in ({"outcome": outcome} | both).items()
    }
    return xr.Dataset(variables, coords)


def numbers(axes):
    return [text.get_text() for text in axes.texts]


def percent(outcome):
    finished = np.sum(outcome != "")
    return [f"{100 * np.sum(outcome == 'S') / finished:.0f}"] if finished else []


def test_a_map_of_two_factors_tells_the_share_of_successes(drawn, tmp_path):
    data = dataset({"sigma": 3, "dithering": 2, "theta_i": 4, "position": 2, "repeat": 2})
    assert draw(data, tmp_path) == "map.png and map.pdf"
    assert {path.name for path in tmp_path.iterdir()} == {"map.png", "map.pdf"}
    panels = [ax for ax in drawn[0].axes if ax.texts]
    assert [ax.get_title(loc="left") for ax in panels] == ["dithering off", "dithering on"]
    for k, ax in enumerate(panels):  # both from small to large
        cells = data.outcome.values[:, k]
        expected = [percent(cells[i, j]) for j in (3, 2, 1, 0) for i in (2, 1, 0)]
        assert numbers(ax) == [number for cell in expected for number in cell]
        assert [t.get_text() for t in ax.get_xticklabels()] == ["0.075", "0.15", "0.3"]


def test_a_map_of_positions_tells_the_share_of_successes_at_each(drawn, tmp_path):
    data = dataset({"dithering": 2, "position": 16, "repeat": 6})
    assert draw(data, tmp_path) == (
        "outcomes.png and outcomes.pdf, positions.png and positions.pdf"
    )
    panels = drawn[-1].axes[:2]
    for k, ax in enumerate(panels):
        expected = [percent(data.outcome.values[k, i]) for i in range(16)]
        assert numbers(ax) == [number for cell in expected for number in cell]
        where = [text.get_position() for text in ax.texts]
        np.testing.assert_allclose(where, 100 * np.stack([data.cube_y, data.cube_x], axis=1))


def test_single_runs_at_positions_are_squares_without_numbers(drawn, tmp_path):
    data = dataset({"position": 16, "repeat": 1})
    data = data.expand_dims(theta_i=[0.1])
    data.theta_i.attrs = about("theta_i")
    draw(data, tmp_path)
    ax, bar = drawn[-1].axes
    assert not ax.texts
    shown = ax.collections[0].get_array()
    outcome = data.outcome.values.ravel()
    np.testing.assert_array_equal(shown[outcome != ""] == 100, outcome[outcome != ""] == "S")
    assert np.ma.getmaskarray(np.ma.masked_invalid(shown))[outcome == ""].all()
    assert bar.get_ylabel() == "S, % (1 run each)"


def test_demonstrated_positions_are_framed_where_the_dataset_knows_them(drawn, tmp_path):
    data = dataset({"dithering": 2, "position": 16, "repeat": 6})
    draw(data, tmp_path)  # as of a study of a file of records
    assert [ax.patches[:] for ax in drawn[-1].axes[:2]] == [[], []]
    assert not drawn[-1].legends
    x, y = np.array([0.25, 0.4, 0.3]), np.array([-0.1, 0.0, 0.05])
    known = data.assign_coords(
        demonstrated_x=("demonstration", x), demonstrated_y=("demonstration", y)
    )
    draw(known, tmp_path)
    for ax in drawn[-1].axes[:2]:
        (frame,) = ax.patches
        corners = (*frame.get_xy(), frame.get_width(), frame.get_height())
        np.testing.assert_allclose(corners, (-10, 25, 15, 15))  # cm: to the left, and ahead
    (legend,) = drawn[-1].legends
    assert [text.get_text() for text in legend.get_texts()] == ["demonstrated"]


@pytest.mark.parametrize(
    "sizes", [{"theta_i": 10, "dithering": 2}, {"theta_i": 4, "sigma": 4}, {"dithering": 2}]
)
def test_few_values_are_drawn_as_in_the_paper(sizes, drawn, tmp_path):
    assert draw(dataset(sizes | {"position": 5, "repeat": 3}), tmp_path) == (
        "outcomes.png and outcomes.pdf"
    )
