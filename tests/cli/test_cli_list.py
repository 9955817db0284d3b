import re

from study_helpers import made_up_study, write

from jaxreplay import cli

TEXT = "theta_i = 0.01\n[axis]\njump = ['own_tau', 'same_tau']"


def test_list_has_a_line_for_each_study(tmp_path, capsys):
    config = write(tmp_path, TEXT)
    made_up_study(config, tmp_path / "a")
    made_up_study(config, tmp_path / "b" / "c")
    (tmp_path / "b" / "c" / "shards" / "00001.nc").unlink()
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "study.json").write_text("{")
    assert cli.main(["list", str(tmp_path)]) == 0
    head, a, c, d = capsys.readouterr().out.splitlines()
    assert head.split() == ["study", "runs", "S,", "%", "axes"]
    assert re.search(r"/a +30  +\d+ \(\d+–\d+\)  jump × 2$", a)
    assert re.search(r"/b/c  15 of 30  +\d+ \(\d+–\d+\)  jump × 2$", c)
    assert "is not the manifest of a study" in d
