"""Figures and tables read nothing but the dataset: a saved and reloaded one gives the same."""

import io
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from PIL import Image
from study_helpers import made_up_study, write

from jaxreplay import open_study
from jaxreplay.figures.draw import draw
from jaxreplay.figures.table import table

AXES = {
    "outcomes": """
        theta_i = 0.01
        zip = [["motor_unit", "sigma_camera"]]
        [axis]
        motor_unit = [0.005, 0.01, 0.02]
        sigma_camera = [0.1, 0.1, 0.3]
        jump = ["own_tau", "same_tau"]
        """,
    "map": """
        [axis]
        theta_i.logspace = [-1, -3, 5]
        sigma = [0.1, 0.2, 0.4, 0.8, 1.6]
        dithering = [true, false]
        """,
    "positions": """
        theta_i = 0.01
        positions = {x.linspace = [0.25, 0.4, 4], y.linspace = [-0.1, 0.1, 4]}
        [axis]
        light = [true, false]
        """,
}


def pictures(dataset, folder):
    """The figures of a dataset, as pixels by name."""
    folder.mkdir()
    draw(dataset, folder)
    return {path.name: np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))}


@pytest.mark.parametrize("name", AXES)
def test_a_reloaded_dataset_gives_the_same_table_and_figures(tmp_path, name):
    made_up_study(write(tmp_path, AXES[name]), tmp_path / "study")
    dataset = open_study(tmp_path / "study")
    with xr.open_dataset(io.BytesIO(dataset.to_netcdf(engine="scipy")), engine="scipy") as file:
        reloaded = file.load()
    assert table(reloaded) == table(dataset)
    before, after = (pictures(d, tmp_path / k) for d, k in ((dataset, "a"), (reloaded, "b")))
    assert f"{name}.png" in before
    assert before.keys() == after.keys()
    for picture in before:
        np.testing.assert_array_equal(before[picture], after[picture])


def test_of_the_study_figures_load_what_describes_its_dataset_and_no_more():
    script = (
        "import sys, jaxreplay.figures.draw, jaxreplay.figures.table;"
        "print(*(name for name in sys.modules if name.startswith('jaxreplay.study')))"
    )
    found = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    assert found.stdout.decode().split() == ["jaxreplay.study", "jaxreplay.study.dataset"]
