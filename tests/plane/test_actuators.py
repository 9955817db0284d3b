import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plane_helpers import (
    AWAY,
    EXACT,
    HIGH,
    LOW,
    OLD,
    PERIOD,
    SCAN,
    SUBSTEP,
    UNIT,
    plane_with,
    send,
)  # fmt: skip

from jaxreplay.plane.actuators import Servo, Settings, track_speeds


def speeds(command, n, unit=UNIT, dithering=True, noise=0.0, params=EXACT):
    """Speeds `[n, 2]` of n pairs of tracks for one command."""
    chance = np.random.default_rng(0).uniform(size=(n, 2))
    settings = Settings(*(np.full(n, v, float) for v in (unit, dithering, 1, 1, *5 * [0])))
    gain, noise = np.ones((n, 2)), np.full((n, 2), noise)
    return track_speeds(params, settings, gain, np.tile(command, (n, 1)), chance, noise)


@pytest.mark.parametrize("unit", [0.005, 0.02])
@pytest.mark.parametrize(("wanted", "units"), [(0.4, 0), (0.6, 1), (-0.6, -1), (-3.4, -3), (5, 5)])
def test_tracks_run_at_the_nearest_whole_unit(unit, wanted, units):
    env = plane_with(AWAY, motor_unit=unit)
    send(env, [wanted * unit, wanted * unit, HIGH, 0, 0], 1)
    assert env.pose.robot[0, 0] == pytest.approx(units * unit * (1 - SUBSTEP), abs=1e-9)


def test_no_track_runs_faster_than_its_top_speed_in_whole_units():
    assert speeds([1, -1], 1)[0] == pytest.approx([0.3, -0.3])
    assert speeds([1, -1], 1, unit=0.07)[0] == pytest.approx([0.28, -0.28])
    assert np.abs(speeds([0.299, -0.299], 1000, unit=0.07)).max() == pytest.approx(0.28)


@given(st.floats(-20, 20), st.sampled_from([0.001, 0.005, 0.01]))
def test_dithered_speeds_are_the_units_around_the_command_and_mean_the_command(wanted, unit):
    n = 4000
    ran = speeds([wanted * unit, -wanted * unit], n, unit) / unit
    np.testing.assert_allclose(ran, np.rint(ran), atol=1e-9)
    assert np.abs(ran - [wanted, -wanted]).max() < 1 + 1e-9
    spread = np.sqrt((wanted % 1) * (1 - wanted % 1) / n)
    np.testing.assert_allclose(ran.mean(axis=0), [wanted, -wanted], atol=5 * spread + 1e-9)


def test_dithered_a_robot_comes_as_far_as_commanded_and_undithered_it_stays():
    n, steps = 64, 100
    env = plane_with(*[AWAY] * n, dithering=np.arange(n) % 2 == 0)
    send(env, [0.4 * UNIT, 0.4 * UNIT, HIGH, 0, 0], steps * PERIOD)
    way = env.pose.robot[:, 0] / (UNIT * PERIOD)  # units × steps of the mean of two tracks
    np.testing.assert_array_equal(env.pose.robot[1::2], 0)
    spread = np.sqrt(0.4 * 0.6 * steps / 2)
    assert way[::2].mean() == pytest.approx(0.4 * steps, abs=5 * spread / np.sqrt(n / 2))
    assert way[::2].std() == pytest.approx(spread, rel=0.5)  # each world and track its own chance


def test_wheel_noise_stays_within_its_share():
    env = plane_with(*[AWAY] * 20, params=OLD)
    send(env, [0.05, 0.05, HIGH, 0, 0], 1)
    way = env.pose.robot[:, 0]
    assert way.std() > 0
    np.testing.assert_allclose(way, 0.05 * (1 - SUBSTEP), rtol=OLD.wheel_noise)


@pytest.mark.parametrize("battery", [0.5, 1.0, 1.25])
def test_a_servos_way_is_its_speed_times_the_voltage_after_the_restart(battery):
    env = plane_with(AWAY, battery=battery)
    send(env, [0, 0, LOW, SCAN, 0], 1)
    running = 1 - EXACT.servo_restart
    assert HIGH - env.pose.elevation[0] == pytest.approx(EXACT.elevation_speed * battery * running)
    assert env.pose.tilt[0] == pytest.approx(EXACT.tilt_speed * battery * running)


@pytest.mark.parametrize("battery", [0.5, 1.0, 1.25])
def test_a_servo_travels_for_its_way_over_its_speed_and_the_restart(battery):
    env = plane_with(AWAY, battery=battery)
    speed = EXACT.elevation_speed * battery
    near = EXACT.elevation_dead_band + 1e-9
    steps = 0
    while env.pose.elevation[0] - LOW > near:
        send(env, [0, 0, LOW, 0, 0], PERIOD)
        steps += 1
    exact = EXACT.servo_restart + (HIGH - LOW - near) / speed
    assert exact <= steps * PERIOD < exact + PERIOD
    send(env, [0, 0, LOW, 0, 0], 1)
    assert env.pose.elevation[0] - LOW <= near


def test_a_set_point_beyond_a_servos_limits_is_the_limit():
    env = plane_with(AWAY)
    send(env, [0, 0, -1, 9, 0], 5)
    reached = env.pose.elevation[0], env.pose.tilt[0]
    assert reached[0] == pytest.approx(LOW, abs=EXACT.elevation_dead_band)
    assert reached[1] == pytest.approx(SCAN, abs=EXACT.tilt_dead_band)
    assert reached[1] <= SCAN


SERVO = Servo(0.0, 1.0, speed=0.5, resolution=0.01, dead_band=0.02, restart=0.05)


def run(servo, position, set_points, battery=1.0):
    """Positions, step by step; the first set point is that of the step before."""
    position, set_point = np.array([position]), np.array([set_points[0]])
    way = []
    for command in set_points[1:]:
        position, set_point = servo.move(position, set_point, command, np.array([battery]), PERIOD)
        way.append(position[0])
    return np.array(way)


def test_set_points_are_rounded_to_the_servos_resolution():
    assert run(SERVO, 0.5, [0.5] + [0.6049] * 20)[-1] == pytest.approx(0.60)
    assert run(SERVO, 0.5, [0.5] + [0.6051] * 20)[-1] == pytest.approx(0.61)


def test_a_servo_stays_within_its_dead_band_and_leaves_it_beyond():
    np.testing.assert_array_equal(run(SERVO, 0.505, [0.5] + [0.52] * 5), 0.505)
    assert run(SERVO, 0.505, [0.5] + [0.53] * 5)[-1] == pytest.approx(0.53)


def test_a_set_point_that_changes_each_step_costs_the_restart_each_time():
    steady = run(SERVO, 0.0, [0.0] + [1.0] * 10)
    restless = run(SERVO, 0.0, [0.0] + [1.0, 0.9] * 5)
    share = 1 - SERVO.restart / PERIOD
    full = SERVO.speed * PERIOD
    assert steady[-1] == pytest.approx((9 + share) * full)
    assert restless[-1] == pytest.approx(10 * share * full)


def test_a_change_below_the_resolution_is_none():
    calm = run(SERVO, 0.0, [1.0] + [0.999, 0.998] * 5)
    assert calm[-1] == pytest.approx(10 * SERVO.speed * PERIOD)


def test_the_head_lowered_over_the_cube_rests_on_it_and_goes_down_beside_it():
    corner = (EXACT.reach + 0.04, 0, np.pi / 4)
    env = plane_with((0.13, 0, 0), (0.3, 0, 0), (0.13, 0.07, 0), corner)
    before = env.pose.cube.copy()
    send(env, [0, 0, LOW, 0, 0], 5)
    on_top = EXACT.side + EXACT.head
    np.testing.assert_allclose(env.pose.elevation, [on_top, LOW, LOW, on_top], atol=1e-9)
    np.testing.assert_array_equal(env.pose.cube, before)
    send(env, [-0.02, -0.02, LOW, 0, 0], 5)
    assert env.pose.elevation[0] == pytest.approx(LOW)  # once it has backed off
