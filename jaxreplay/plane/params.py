"""The constants of robot, cube, sensors and area, with their sources.

SI units, angles in radians. Enki and ARGoS are robot simulators.

The paper names the robot and its sensors but gives almost no number; what it leaves open is
marked as an *assumption*. The robot starts at the origin, heading along +x; y is to its left.
"""

from dataclasses import dataclass
from math import isfinite, pi
from typing import Any

SENSOR_NAMES = ("camera", *(f"proximeter_{k}" for k in range(6)))
COMMAND_NAMES = ("left_track", "right_track", "elevation", "tilt", "magnet")
# Highest minus lowest value of each sensor: the camera's go from −1 to 1, the others from 0 to 1.
SENSOR_RANGES = (2.0, *6 * (1.0,))

N_PROXIMETERS = 6
MOST_STEPS = 100_000  # of a run; noise is drawn for all of them when it starts
_WHOLE = {"substeps", "image_width", "beam_rays"}
_MAY_BE_ZERO = {
    "wheel_noise", "sensor_noise", "camera_noise", "proximeter_noise", "servo_restart",
    "elevation_dead_band", "tilt_dead_band", "floor_friction", "contact_friction", "low",
    "beam_half_angle", "lift", "track_bias", "placing", "heading", "cube_turn", "push",
}  # fmt: skip

GRAVITY = 9.81  # m/s²
# A robot of which every run is alike: the world before robots differed from run to run.
NOMINAL: dict[str, Any] = {
    "motor_unit": 0.005,
    "dithering": False,
    "battery": 1.0,
    "sensor_noise": 1.0,
    "track_bias": 0.0,
    "placing": 0.0,
    "heading": 0.0,
    "cube_turn": 0.0,
    "push": 0.0,
}


@dataclass(frozen=True)
class PlaneParams:
    """The constants of a run.

    Those that `NOMINAL` names are defaults: each world can be started with values of its own
    (`reset`'s options). Each constant is described, with its unit and source, where it is defined.

    Raises:
        ValueError: a value that is infinite or NaN, or negative or 0 where it may not be; a gripper
            that does not fit the robot; an area without the robot.
    """

    # Time
    control_period: float = 0.1  # s; assumption
    # Physics steps per control step. After pushes, sweeps and grasps, cubes are within 0.3 mm and
    # 0.4° of where they are with 160 steps, and the alignment of a grasp within 0.1 mm (medians):
    # experiments/benchmarks/substeps.py
    substeps: int = 5
    time_limit: float = 180.0  # s; paper: 3 minutes; a longer run has outcome Fs

    # Robot: marXbot
    hull_radius: float = 0.085  # m; Enki, ARGoS
    mass: float = 1.6  # kg; ARGoS
    track_separation: float = 0.15  # m; Enki
    top_speed: float = 0.30  # m/s; Enki
    wheel_noise: float = 0.02  # of each track's speed, ± this share, uniform; Enki
    # m/s; paper: "relatively low resolution"; assumption, chosen as described at `track_bias`
    motor_unit: float = 0.01
    dithering: bool = False  # round by chance, with the mean unchanged; proposed in § 3
    # In each run each track's speed is multiplied by 1 + track_bias · u, u uniform in [−1, 1].
    # An assumption, as are `placing`, `heading` and `cube_turn` below. These and the motor unit
    # were chosen together, once, without looking at the filter, so that the world needs feedback:
    # the coarsest motor unit of 0.5 and 1 cm/s at which the teacher fetches the cube in 20 of 20
    # demonstrations for each of ten seeds, with a median alignment error of 1.5–3 mm (2.5 mm; of
    # single seeds 1.7–3.2), while the nearest demonstration played blindly succeeds in at most
    # 30 % of 300 runs (24 and 22 % for two of these seeds): experiments/world.py
    track_bias: float = 0.12
    traction: float = 0.6  # friction coefficient of tracks on floor; assumption

    # Gripper, in front of the hull, with the magnet's face at its end; all assumptions
    reach: float = 0.135  # m from the robot's centre to the magnet's face
    gripper_width: float = 0.064  # m
    head: float = 0.02  # m by which the head extends above and below its middle
    low: float = 0.03  # m, height of the head's middle, gripper down: as high as the cube's centre
    high: float = 0.12  # m, height of the head's middle with the gripper up
    scanning_tilt: float = pi / 2  # rad; the proximeters look ahead, the magnet down
    grasping_tilt: float = 0.2  # rad; below this the magnet counts as facing ahead

    # Servos: controlled in position, at speeds proportional to the battery's voltage (paper). All
    # values are assumptions.
    battery: float = 1.0  # voltage, as a share of a full battery's
    elevation_speed: float = 0.03  # m/s on a full battery
    tilt_speed: float = 0.8  # rad/s on a full battery
    elevation_resolution: float = 0.0005  # m; set points are rounded to multiples of this
    tilt_resolution: float = 0.01  # rad
    elevation_dead_band: float = 0.001  # m; a servo this close to its set point stands still
    tilt_dead_band: float = 0.02  # rad
    servo_restart: float = 0.05  # s for which a servo stands after its set point has changed

    # Magnet; all assumptions
    # m, the largest gap to the cube's face that the magnet closes; also the slip that ends a hold
    magnet_gap: float = 0.003
    # rad, the largest angle to that face; also the turn that ends a hold
    magnet_angle: float = pi / 12
    magnet_offset: float = 0.02  # m from the face's centre, sideways, at which the hold is 0
    magnet_force: float = 0.5  # N, on a centred face
    magnet_radius: float = 0.01  # m, lever of the hold against tipping and turning
    lift: float = 0.03  # m; a cube raised by this much since its grasp is lifted

    # Cube
    side: float = 0.06  # m; assumption
    cube_mass: float = 0.005  # kg; polystyrene, 15–30 kg/m³
    floor_friction: float = 0.4  # coefficient of cube on floor; assumption
    contact_friction: float = 0.5  # coefficient of cube on robot; assumption

    # Sensors
    sensor_noise: float = 1.0  # factor on the noise of camera and proximeters

    # Camera above the robot's centre
    camera_height: float = 0.10  # m; assumption: below the raised head, above the lowered one
    field_of_view: float = pi * 70 / 180  # rad; assumption: all cube positions are in view
    image_width: int = 640  # px; ARGoS
    camera_noise: float = 1.5  # px, standard deviation; assumption

    # Infrared proximeters on the gripper head, side by side, looking ahead while it scans
    # m to the left of its middle; assumption
    proximeter_offsets: tuple[float, ...] = (0.030, 0.018, 0.006, -0.006, -0.018, -0.030)
    proximeter_range: float = 0.09  # m; the end of Enki's curve, see sensors.infrared
    beam_half_angle: float = pi * 8 / 180  # rad; assumption
    beam_rays: int = 5  # in each beam
    beam_steepest: float = pi / 4  # rad; light that points up by more glances off; assumption
    proximeter_noise: float = 0.03  # of the response, ± this share, uniform; Enki

    # Where robot and cube are put down in a run: off by up to these, uniformly
    placing: float = 0.01  # m, of the robot, in x and in y
    heading: float = 0.1  # rad, of the robot
    cube_turn: float = 0.1  # rad, of the cube, from facing the robot's start; the magnet takes 0.26
    # m by which somebody moves each track forward or back, up to this, once on the way (see start)
    push: float = 0.0

    # Experimental area: a run ends when the robot's hull crosses its border; assumption
    area: tuple[float, float, float, float] = (-0.25, 0.75, -0.35, 0.35)  # m: x, x, y, y

    def __post_init__(self):
        for name, value in vars(self).items():
            for number in value if isinstance(value, tuple) else [value]:
                if not isfinite(number):
                    raise ValueError(f"{name} must be finite; got {value}")
            if isinstance(value, tuple) or name == "dithering":
                continue
            if value < 0 or (value == 0 and name not in _MAY_BE_ZERO):
                least = "0 or more" if name in _MAY_BE_ZERO else "greater than 0"
                raise ValueError(f"{name} must be {least}; got {value}")
            if name in _WHOLE and value != round(value):
                raise ValueError(f"{name} must be a whole number; got {value}")
        if len(self.area) != 4:
            raise ValueError(f"area must be 4 numbers: x, x, y, y; got {self.area}")
        x0, x1, y0, y1 = self.area
        margin = min(-x0, x1, -y0, y1) - self.hull_radius
        for good, message in (
            (
                len(self.proximeter_offsets) == N_PROXIMETERS,
                "proximeter_offsets must be 6 numbers",
            ),
            (margin > 0, "area must contain the robot's hull at the origin"),
            (self.low < self.high, "low must be less than high"),
            (self.hull_radius < self.reach, "reach must be greater than hull_radius"),
            (self.max_steps <= MOST_STEPS, f"time_limit must be at most {MOST_STEPS} periods"),
            (self.max_steps >= 1, "time_limit must be at least one control_period"),
        ):
            if not good:
                raise ValueError(message)

    @property
    def max_steps(self) -> int:
        """The number of control steps within the time limit."""
        return round(self.time_limit / self.control_period)
