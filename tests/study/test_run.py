import numpy as np
import pytest
import xarray as xr
from study_helpers import SMALL, of_beginnings

import jaxreplay as jr
from jaxreplay.plane.positions import TESTED
from jaxreplay.study.config import load_config
from jaxreplay.study.open import config_of
from jaxreplay.study.run import run_study

pytestmark = pytest.mark.usefixtures("fewer_windows")

DITHERED = """
seed = 4
repeats = 1
theta_i = 0.01
jump = "own_tau"
[axis]
dithering = [true, false]
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A small study."""
    folder = tmp_path_factory.mktemp("out")
    config = of_beginnings(tmp_path_factory.mktemp("config"), SMALL)
    run_study(load_config(config), folder)
    return config, folder


@pytest.fixture(scope="module")
def dithered(tmp_path_factory):
    """A study of which the one above is a half, and what running it returned."""
    folder = tmp_path_factory.mktemp("dithered")
    return folder, run_study(load_config(of_beginnings(folder, DITHERED)), folder)


def test_the_dataset_is_labelled(study):
    dataset = jr.open_study(study[1])
    sizes = {"theta_i": 1, "jump": 1, "position": 5, "repeat": 1}
    assert dict(dataset.sizes) == sizes
    assert dataset.outcome.dims == ("theta_i", "jump", "position", "repeat")
    assert dataset.alignment_error.attrs["units"] == "mm"
    assert dataset.duration.attrs["units"] == "s"
    np.testing.assert_array_equal(dataset.cube_x, TESTED[:, 0])
    assert set(np.unique(dataset.outcome)) <= {"S", "Fs", "Fg", "Fb"}
    assert np.isfinite(dataset.log_evidence).all()


def test_a_stall_is_given_for_each_run_over_3_minutes_and_of_no_other(study, dithered):
    for dataset in (jr.open_study(study[1]), dithered[1]):
        stalled = dataset.outcome == "Fs"
        np.testing.assert_array_equal(dataset.stall.isin(["fixed", "cyclic", "slow"]), stalled)
        np.testing.assert_array_equal(dataset.stall == "", ~stalled)
        np.testing.assert_array_equal(dataset.duration == 180, stalled)


def test_running_a_study_returns_what_opening_it_does(dithered):
    folder, returned = dithered
    opened = jr.open_study(folder)
    xr.testing.assert_identical(returned, opened)
    assert opened.outcome.dims == ("dithering", "position", "repeat")
    assert list(opened.dithering.values) == [True, False]
    assert config_of(opened) == load_config(folder / "study.toml")


def test_a_run_comes_to_the_same_in_whichever_study_it_stands(study, dithered):
    alone = jr.open_study(study[1]).isel(theta_i=0, jump=0)
    among = dithered[1].sel(dithering=False)
    audits = ["total_variation", "command_error"]  # of the first run of each shard
    xr.testing.assert_equal(alone.drop_vars(audits), among.drop_vars(audits))
    assert not (dithered[1].sel(dithering=True).log_evidence == alone.log_evidence).any()


def test_the_same_seed_gives_the_same_study(study, tmp_path):
    config, folder = study
    xr.testing.assert_identical(run_study(load_config(config), tmp_path), jr.open_study(folder))
