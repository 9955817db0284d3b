import numpy as np
from study_helpers import made_up_study, write

from jaxreplay import open_study
from jaxreplay.figures.outcomes import figure_3, label, title
from jaxreplay.figures.table import table, wilson


def study(folder, text):
    made_up_study(write(folder, text), folder)
    return open_study(folder)


def test_a_study_of_one_value_each_has_a_row_and_a_figure(tmp_path):
    dataset = study(tmp_path, "theta_i = 0.01")
    assert len([line for line in table(dataset).splitlines() if line]) == 6
    figure_3(dataset).savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 0


def test_a_study_of_no_numbers_has_a_figure(tmp_path):
    dataset = study(tmp_path, "theta_i = 0.01\n[axis]\ndithering = [true, false]")
    figure = figure_3(dataset)
    figure.savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 0
    outcomes = figure.axes[0]
    assert [tick.get_text() for tick in outcomes.get_xticklabels()] == ["on", "off"]
    assert outcomes.get_xlabel() == "temporal dithering of the tracks"


def test_bars_are_shares_of_the_runs_and_whiskers_wilsons_interval_of_success(drawn, tmp_path):
    text = "[axis]\ntheta_i.logspace = [-1, -3, 3]\njump = ['same_tau', 'own_tau']"
    dataset = study(tmp_path, text)
    figure_3(dataset).savefig(tmp_path / "figure.png")
    rows = np.reshape(drawn[0].axes[:4], (2, 2))
    for k, (ax, _) in enumerate(rows):
        bars, whiskers = ax.containers[:4], ax.containers[4]
        runs = dataset.sortby("theta_i").isel(jump=k).outcome
        for bar, outcome in zip(bars, ("S", "Fs", "Fg", "Fb"), strict=True):
            share = 100 * (runs == outcome).sum(("position", "repeat")) / 15
            np.testing.assert_allclose([patch.get_height() for patch in bar], share)
        successes = (runs == "S").sum(("position", "repeat")).values
        (segments,) = (lines.get_segments() for lines in whiskers.lines[2])
        reach = [100 * np.array(wilson(n, 15)) for n in successes]
        np.testing.assert_allclose([segment[:, 1] for segment in segments], reach)
        np.testing.assert_allclose(
            [segment[:, 0] for segment in segments], [[x, x] for x in (0, 1, 2)]
        )
    above = "same_tau: a jump keeps τ (equation 6 as printed)"
    assert rows[0, 0].get_title(loc="left") == above
    assert [t.get_text() for t in rows[1, 0].get_xticklabels()] == [
        "$10^{-3}$",
        "$10^{-2}$",
        "$10^{-1}$",
    ]


def test_titles_and_labels_write_symbols_values_and_units(tmp_path):
    dataset = study(
        tmp_path,
        "[axis]\ntheta_i = [0.1, 0]\nmotor_unit = [0.005]\nsigma = [0.25]\ndithering = [true]",
    )
    values = {"theta_i": 0.1, "motor_unit": 0.005, "sigma": 0.25, "dithering": True}
    assert title(dataset, values) == (
        "$\\theta_I$ $10^{-1}$, motor unit 0.005 m/s, σ 0.25, dithering on"
    )
    assert title(dataset, {"theta_i": 0.0}) == "$\\theta_I$ 0"
    assert label(dataset, "theta_i") == "$\\theta_I$, probability to jump to another record"
    assert label(dataset, "motor_unit") == "resolution of the track speeds, m/s"
    assert label(dataset, "dithering") == "temporal dithering of the tracks"
