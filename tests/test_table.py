import numpy as np
import pytest
from scipy.stats import binomtest

from jaxreplay.table import wilson


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
        theirs = binomtest(k, n).proportion_ci(method="wilson")
        assert wilson(k, n) == pytest.approx((theirs.low, theirs.high), abs=1e-6)


def test_after_no_trial_the_rate_may_be_anything():
    assert wilson(0, 0) == (0, 1)
