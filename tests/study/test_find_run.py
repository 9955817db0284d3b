import pytest

from jaxreplay.errors import ConfigError
from jaxreplay.study.again import find_run
from jaxreplay.study.config import StudyConfig

CONFIG = StudyConfig({"jump": ["same_tau", "own_tau"], "theta_i": [0.1, 10**-1.5]})


def test_a_run_is_found_by_its_number_or_its_values():
    assert find_run(CONFIG, 7) == find_run(CONFIG, "7") == 7
    values = {"jump": "own_tau", "theta_i": 0.0316, "position": 1, "repeat": 2}
    assert find_run(CONFIG, values) == 3 * 15 + 1 * 3 + 2
    assert find_run(CONFIG, {}) == 0
    many = StudyConfig({"theta_i": [0.1]}, positions=[[0.3, 0.001 * k] for k in range(150)])
    assert find_run(many, {"position": 101}) == 3 * 101  # not 100, which is as near as 1 %
    fewer = StudyConfig({"records": [6, [0, 4]]}, {"theta_i": 0.1})
    assert find_run(fewer, {"records": [0, 4]}) == find_run(fewer, {"records": "0 4"}) == 15
    assert find_run(fewer, {"records": 6}) == 0


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (60, "give 0 to 59"),
        ("Fx", "give a run's number, or one of S, .*, slow, or values such as theta_i=0.01,pos"),
        ("S", "no outcomes yet"),
        ({"speed": 1}, "the study has no speed; what varies is jump, theta_i, position, repeat"),
        ({"theta_i": 0.5}, r"theta_i=0\.5: the study's values are 0\.1, 0\.03"),
        ({"repeat": 3}, "values are 0, 1, 2"),
    ],
)
def test_a_run_that_is_not_there_is_one_line(run, message):
    with pytest.raises(ConfigError, match=message):
        find_run(CONFIG, run)
