"""Studies made by a version whose results may differ can be read, but are not continued."""

import json

import numpy as np
import pytest
from study_helpers import as_made_before, by_robot, made_up_study, some_records, write

from jaxreplay import cli, open_study
from jaxreplay.errors import ConfigError
from jaxreplay.study import demonstrations, store
from jaxreplay.study.config import load_config
from jaxreplay.study.run import run_study

TEXT = "theta_i = 0.01\n[axis]\njump = ['own_tau', 'same_tau']"
OTHERS = [1, None]


@pytest.fixture
def config(tmp_path):
    return write(tmp_path, TEXT)


def content(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("number", OTHERS)
def test_a_study_of_another_format_is_read_and_never_continued(config, tmp_path, capsys, number):
    folder = tmp_path / "out"
    made_up_study(config, folder, format=number)
    dataset = open_study(folder)
    assert (dataset.outcome != "").all()
    assert np.isfinite(dataset.log_evidence).all()
    assert cli.main(["show", str(folder)]) == 0
    assert capsys.readouterr().out.count("own_tau") == 1
    before = content(folder)
    run = ["run", str(config), "--out", str(folder)]
    for command in (run, [*run, "--dry-run"], [*run, "--workers", "2"], ["watch", str(folder)]):
        assert cli.main(command) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert f"contains a study of results format {number or 0}; this version" in error
        assert "run the study in another folder" in error
    with pytest.raises(ConfigError, match=f"of results format {number or 0}; .* cannot continue"):
        run_study(load_config(config), folder)
    assert content(folder) == before
    assert {path.name for path in folder.iterdir()} == {"study.json", "shards"}


def test_a_study_of_a_newer_version_is_refused_in_one_line(config, tmp_path, capsys):
    folder = tmp_path / "out"
    made_up_study(config, folder, format=store.RESULTS_FORMAT + 1)
    before = content(folder)
    for command in (["show"], ["plot"], ["watch"]):
        assert cli.main([*command, str(folder)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "is of a newer version of jaxreplay" in error
    assert cli.main(["run", str(config), "--out", str(folder)]) == 2
    assert "is of a newer version of jaxreplay" in capsys.readouterr().err
    assert content(folder) == before


def test_an_unfinished_study_of_another_format_is_not_continued_either(config, tmp_path):
    folder = tmp_path / "out"
    made_up_study(config, folder, format=None)
    (folder / "shards" / "00001.nc").unlink()
    assert (open_study(folder).outcome == "").sum() == 15
    with pytest.raises(ConfigError, match="of results format 0"):
        run_study(load_config(config), folder)
    assert not (folder / "shards" / "00001.nc").exists()


def test_a_studys_identity_has_the_results_format_and_not_the_packages_version(config, monkeypatch):
    def identity():
        study = load_config(config)
        return store.manifest_of(study, by_robot(study, some_records()), 56)

    before = identity()
    with monkeypatch.context() as patch:
        patch.setattr(store, "version", lambda name: "99.9")
        other = identity()
    assert other["versions"] != before["versions"]
    assert other["hash"] == before["hash"]
    assert before["format"] == store.RESULTS_FORMAT
    assert "jaxreplay" not in before
    monkeypatch.setattr(store, "RESULTS_FORMAT", store.RESULTS_FORMAT + 1)
    assert identity()["hash"] != before["hash"]


def test_demonstrations_of_another_format_are_not_taken(config, tmp_path, monkeypatch):
    made = []

    def record(params, positions, seed):
        made.append(seed)
        return some_records()

    monkeypatch.setattr(demonstrations, "record", record)
    study = load_config(config)
    for _ in range(2):
        demonstrations.demonstrations(study, tmp_path / "out")
    assert len(made) == 1
    monkeypatch.setattr(demonstrations, "RESULTS_FORMAT", store.RESULTS_FORMAT + 1)
    demonstrations.demonstrations(study, tmp_path / "out")
    assert len(made) == 2
    assert len(list((tmp_path / "out").glob("demonstrations_*.npz"))) == 2


def test_a_study_of_format_1_is_read_as_of_the_world_of_its_time(tmp_path):
    config = write(tmp_path, "motor_unit = 0.005\ndithering = true\n" + TEXT)
    folder = tmp_path / "out"
    stored = made_up_study(config, folder, format=1)
    new = ("track_bias", "placing", "heading", "cube_turn", "push", "taught", "controller")
    for name in new:
        del stored["config"]["fixed"][name]
    as_made_before(folder, stored, ["lifted"])
    dataset = open_study(folder)
    assert dataset.unverified == 2
    assert (dataset.outcome != "").all()
    assert np.isnan(dataset.lifted).all()
    assert dataset.taught.item() == "nominal"
    assert dataset.dithering.item()
    assert [dataset[name].item() for name in new[:5]] == [0, 0, 0, 0, 0]


def test_a_folder_made_before_a_factor_or_constant_existed_is_continued(config, tmp_path):
    folder, study = tmp_path / "out", load_config(config)
    wanted = made_up_study(config, folder)
    older = json.loads(json.dumps(wanted))
    del older["config"]["fixed"]["controller"], older["plane"]["lift"]
    older = as_made_before(folder, older)
    assert store.claim(folder, wanted) == older  # whose hash the finished shards have
    other = store.manifest_of(
        load_config(config, ["controller=tape"]), by_robot(study, some_records()), 56
    )
    with pytest.raises(ConfigError, match=r"differs in config\.fixed\.controller;"):
        store.claim(folder, other)
