import re

import numpy as np
import pytest
import xarray as xr
from study_helpers import VARIABLES, made_up_study, write

from jaxreplay import open_study
from jaxreplay.figures.table import paired, table, wilson


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [  # R. G. Newcombe, Statistics in Medicine 17 (1998), table I, method 3
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilsons_interval_is_the_published_one(successes, n, low, high):
    assert wilson(successes, n) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize("n", [1, 2, 15, 300])
def test_wilsons_interval_holds_the_rates_that_a_score_test_does_not_reject(n):
    for k in {0, 1, n // 2, n - 1, n}:
        for bound in wilson(k, n):
            assert 0 <= bound <= 1
            if bound not in (0, 1):
                score = abs(k / n - bound) / np.sqrt(bound * (1 - bound) / n)
                assert score == pytest.approx(1.96, abs=1e-3)


def test_after_no_trial_the_rate_may_be_anything():
    assert wilson(0, 0) == (0, 1)


def test_the_interval_of_a_paired_difference_holds_the_true_one_as_often_as_it_says():
    rng = np.random.default_rng(0)
    for shares in ((0.5, 0.3, 0.1, 0.1), (0.85, 0.1, 0.02, 0.03), (0.2, 0.05, 0.05, 0.7)):
        true, held = shares[1] - shares[2], 0
        counts = rng.multinomial(100, shares, 4000)  # both, only one, only other, none
        for _, b, c, _ in counts:
            low, middle, high = paired(b, c, 100)
            assert low <= middle <= high
            assert middle == (b - c) / 100
            held += low <= true <= high
        assert 0.935 < held / len(counts) < 0.985


def test_pairs_without_a_difference_have_an_interval_around_0():
    low, middle, high = paired(0, 0, 300)
    assert middle == 0
    assert low == -high
    assert 0 < high < 0.01


def test_a_cell_that_equals_the_first_has_a_difference_with_an_interval(tmp_path):
    text = "theta_i = 0.01\n[axis]\njump = ['own_tau', 'same_tau']"
    made_up_study(write(tmp_path, text), tmp_path)
    dataset = open_study(tmp_path)
    dataset["outcome"] = xr.full_like(dataset.outcome, "S")
    first, second = table(dataset).splitlines()[1:3]
    assert "+0 (" not in first
    low, _, high = paired(0, 0, 15)
    assert f"+0 ({100 * low:+.0f}, {100 * high:+.0f})" in second


def test_the_table_counts_the_dataset(tmp_path):
    text = "theta_i = 0.01\n[axis]\njump = ['own_tau', 'same_tau']"
    made_up_study(write(tmp_path, text), tmp_path)
    dataset = open_study(tmp_path)
    for k, reading in enumerate(("own_tau", "same_tau")):
        runs = dataset.isel(jump=k)
        counts = [int((runs.outcome == o).sum()) for o in ("S", "Fs", "Fg", "Fb")]
        stalls = [int((runs.stall == s).sum()) for s in ("fixed", "cyclic", "slow")]
        row = table(dataset).splitlines()[1 + k]
        name, *numbers = re.sub(r"\([^)]*\)", "", row).split()  # without intervals
        assert name == reading
        assert [int(n) for n in numbers[:5]] == [*counts, int((runs.lifted == 1).sum())]
        won = (dataset.outcome.values == "S").reshape(2, -1).mean(axis=1)
        expected = "–" if k == 0 else f"{100 * (won[1] - won[0]):+.0f}"
        assert numbers[6] == expected
        assert [int(n) for n in numbers[7:10]] == stalls
        errors = runs.alignment_error.values[runs.outcome.values == "S"]
        assert len(errors) > 1
        assert f"{errors.mean():.2f} ± {errors.std(ddof=1) / len(errors) ** 0.5:.2f}" in row


def test_a_row_of_the_table_is_a_cell_of_the_study():
    dims = ("motor_unit", "dithering", "position", "repeat")
    cells = {
        "outcome": [["S", "S", "Fs"], ["Fs", "Fs", "Fb"]],
        "stall": [["", "", "cyclic"], ["fixed", "slow", ""]],
        "alignment_error": [[1, 3, np.nan], 3 * [np.nan]],
        "duration": [[60, 70, 180], [180, 180, 9]],
        "command_error": [[np.nan, 0.02, 1e-6], 3 * [np.nan]],
    }
    variables = {
        name: (dims, np.array(cell).reshape(1, 2, 1, 3), VARIABLES[name])
        for name, cell in cells.items()
    }
    coords = {
        "motor_unit": ("motor_unit", [0.0025], {"symbol": "motor unit", "units": "m/s"}),
        "dithering": ("dithering", [True, False], {"symbol": "dithering"}),
    }
    header, *rows, audit = table(xr.Dataset(variables, coords)).splitlines()
    assert "Audit: 2 of the runs filtered again" in audit
    assert "in 1, at most by 2.0e-02" in audit
    assert header.split()[:4] == ["motor", "unit", "m/s", "dithering"]
    assert [" ".join(row.split()) for row in rows[:3]] == [
        "0.0025 on 2 1 0 0 67 (21–94) – 0 1 0 2.00 ± 1.00 65.00 ± 5.00",
        "0.0025 off 0 2 0 1 0 (0–56) -67 (-98, +18) 1 0 1 – –",
        "",
    ]
