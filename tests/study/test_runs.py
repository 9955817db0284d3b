import numpy as np
import pytest
from study_helpers import SMALL, TUNED, VARIED, by_robot, some_records, write

from jaxreplay.plane.options import SETTINGS, seed_of
from jaxreplay.plane.params import SENSOR_RANGES
from jaxreplay.plane.positions import TESTED, facing
from jaxreplay.study.config import StudyConfig, load_config
from jaxreplay.study.runs import records_of, runs_of, settings_of, shards_of
from jaxreplay.study.worlds.plane import PLANE_FACTORS as FACTORS


def settings_in(config, runs):
    return settings_of(config, by_robot(config, some_records()), runs)


def test_the_settings_of_a_run_follow_from_its_own_values():
    values = {name: factor.default for name, factor in FACTORS.items()} | {"theta_i": 0.1}

    def config(seed=7, **axes):
        fixed = {name: value for name, value in values.items() if name not in axes}
        return StudyConfig(axes, fixed, repeats=2, seed=seed)

    def settings(config):
        params, seeds, options = settings_in(config, runs := runs_of(config))
        sigma = np.asarray(params.sigma) / SENSOR_RANGES
        np.testing.assert_allclose(sigma.T, np.tile(runs.values["sigma"], (7, 1)), rtol=1e-6)
        np.testing.assert_array_equal(options["cube"], facing(TESTED[runs.position]))
        for name in SETTINGS:
            np.testing.assert_array_equal(options[name], runs.values[name])
        return np.array(seeds, np.uint64)

    one, two = config(theta_i=(0.1,)), config(theta_i=(0.2, 0.1))
    assert len(set(settings(one))) == 10
    np.testing.assert_array_equal(settings(two), np.tile(settings(one), 2))  # cells are comparable
    crossed = settings(config(dithering=(True, False), theta_i=(0.1, 0.2)))
    np.testing.assert_array_equal(crossed, np.tile(settings(one), 4))
    assert not set(settings(one)) & set(settings(config(seed=8)))
    # Neither has a demonstration's noise.
    assert not set(settings(one)) & {seed_of(7, i) for i in range(20)}
    each = settings_in(two, runs_of(two).of(np.array([13, 2])))[1]
    np.testing.assert_array_equal(np.array(each, np.uint64), settings(two)[[13, 2]])


def test_cubes_stand_where_the_file_says(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    assert config.positions == tuple((x, y) for x in (0.3, 0.35) for y in (-0.1, 0, 0.1))
    runs = runs_of(config)
    cubes = settings_in(config, runs)[2]["cube"]
    np.testing.assert_array_equal(cubes[:, :2], np.array(config.positions)[runs.position])
    listed = load_config(write(tmp_path, "theta_i = 0.1\npositions = [[0.3, 0], [0.4, 0.2]]"))
    assert listed.positions == ((0.3, 0.0), (0.4, 0.2))


def test_the_sigma_of_a_sensor_is_the_most_specific_one_given(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    runs = runs_of(config)
    sigma = np.asarray(settings_in(config, runs)[0].sigma)
    wide = runs.values["sigma_camera"] == 0.3
    expected = np.tile([2 * 0.1, 0.2, 0.2, 0.5, 0.2, 0.2, 0.2], (len(runs), 1))
    expected[wide, 0] = 2 * 0.3
    np.testing.assert_allclose(sigma, expected, rtol=1e-6)


def test_runs_of_a_shard_share_the_jump_and_the_records(tmp_path):
    config = load_config(write(tmp_path, VARIED))
    runs, records = runs_of(config), some_records()
    shards = shards_of(config, runs, 8)
    np.testing.assert_array_equal(np.sort(np.concatenate(shards)), np.arange(len(runs)))
    drawn = {}
    for shard in shards:
        assert 0 < len(shard) <= 8
        some = runs.of(shard)
        assert len(set(some.values["jump"])) == 1
        (value,) = set(some.values["records"])
        chosen = records_of(config, by_robot(config, records), some)
        first = [int(s[0, 0]) for s in chosen.sequences()[0]]
        if value == "0 4 19":
            assert first == [0, 4, 19]
        else:
            (repeat,) = set(some.repeat)
            assert len(set(first)) == 6
            assert drawn.setdefault(repeat, first) == first
    assert drawn[0] != drawn[1]


def test_tuned_parameters_are_those_of_the_study(tmp_path):
    file = write(tmp_path, SMALL + "sigma_proximeter_2 = [0.1, 0.2]\n")
    with pytest.warns(UserWarning, match=r"takes the place of axis\.theta_i, axis\.sigma_p"):
        config = load_config(file, params=write(tmp_path, TUNED, "tuned.toml"))
    assert list(config.axes) == ["jump"]
    params, *_ = settings_in(config, runs_of(config))
    np.testing.assert_allclose(params.theta_i, 0.03, rtol=1e-6)
    np.testing.assert_allclose(params.theta_tau, 0.2, rtol=1e-6)
    expected = np.tile(0.05 * np.arange(1, 8), (5, 1))  # in the sensors' units, as in the file
    np.testing.assert_allclose(params.sigma, expected, rtol=1e-6)
