import numpy as np
import pytest
import xarray as xr
from study_helpers import (
    SMALL,
    VARIED,
    as_made_before,
    by_robot,
    made_up_study,
    some_records,
    write,
)

import jaxreplay as jr
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.study import config, store
from jaxreplay.study.config import load_config
from jaxreplay.study.dataset import along, axes_of, cells, is_number
from jaxreplay.study.open import config_of
from jaxreplay.study.store import manifest_of, read_manifest
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS
from jaxreplay.study.worlds.plane import Plane


def identity(path, records):
    study = load_config(path)
    return manifest_of(study, by_robot(study, records), 56)["hash"]


def test_a_study_made_before_a_factor_was_known_stays_what_it_was(tmp_path, monkeypatch):
    path, records = write(tmp_path, SMALL), some_records()
    stored = made_up_study(path, tmp_path)
    before = jr.open_study(tmp_path)
    assert (before.outcome != "").all()
    assert identity(path, records) == stored["hash"]
    new = FACTORS | {"mood": FACTORS["light"]}
    monkeypatch.setattr(Plane, "factors", new)
    for module in (config, store):
        monkeypatch.setattr(module, "PLANE_FACTORS", new)
    xr.testing.assert_identical(jr.open_study(tmp_path), before)
    assert identity(path, records) == stored["hash"]
    older = read_manifest(tmp_path)
    del older["config"]["zip"], older["config"]["positions"]  # nor were these
    as_made_before(tmp_path, older)
    assert config_of(jr.open_study(tmp_path)).positions == load_config(path).positions


def test_every_factor_is_a_coordinate_that_says_how_to_write_it(tmp_path):
    path = write(tmp_path, VARIED)
    made_up_study(path, tmp_path)
    dataset = jr.open_study(tmp_path)
    assert dataset.outcome.dims == (
        "motor_unit", "jump", "records", "sigma_proximeter_2", "position", "repeat"
    )  # fmt: skip
    assert dataset.sigma_camera.dims == ("motor_unit",)
    given = {name for name, value in load_config(path).fixed.items() if value is not None}
    for name in given | set(load_config(path).axes):
        about, factor = dataset[name].attrs, FACTORS[name]
        assert (about["symbol"], about["long_name"]) == (factor.symbol, factor.long_name)
        assert about.get("units", "") == factor.units
        assert is_number(dataset, name) == bool(factor.units)
    for name in given:
        assert dataset[name].dims == ()
        assert dataset[name].item() == load_config(path).fixed[name]
    assert not {"light", "sigma_proximeter_3"} & set(dataset.coords)
    assert axes_of(dataset) == ["motor_unit", "jump", "records", "sigma_proximeter_2"]
    assert along(dataset, "motor_unit") == ["motor_unit", "sigma_camera"]
    first, *_, last = cells(dataset, ["motor_unit", "jump"])
    assert first[0] == {"motor_unit": 0.005, "sigma_camera": 0.1, "jump": "own_tau"}
    assert last[0] == {"motor_unit": 0.01, "sigma_camera": 0.3, "jump": "same_tau"}
    xr.testing.assert_identical(last[1], dataset.isel(motor_unit=1, jump=1))


def test_demonstrated_positions_are_those_of_the_studys_own_demonstrations(tmp_path):
    made_up_study(write(tmp_path, SMALL), tmp_path / "own")
    own = jr.open_study(tmp_path / "own")
    np.testing.assert_array_equal(own.demonstrated_x, DEMONSTRATED[:, 0])
    np.testing.assert_array_equal(own.demonstrated_y, DEMONSTRATED[:, 1])
    some_records().save(tmp_path / "mine.npz")
    made_up_study(write(tmp_path, 'demonstrations = "mine.npz"\n' + SMALL), tmp_path / "mine")
    assert not {"demonstrated_x", "demonstrated_y"} & set(jr.open_study(tmp_path / "mine").coords)


def test_opening_what_is_no_study(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"study\.json is missing"):
        jr.open_study(tmp_path)
    (tmp_path / "study.json").write_text('{"config": ')
    with pytest.raises(ValueError, match="is not the manifest of a study"):
        jr.open_study(tmp_path)
