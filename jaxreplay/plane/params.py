"""Every constant of the plane, with its source. SI units, angles in radians.

The paper names the robot and its sensors but gives almost no number; what it leaves open is an
*assumption*, said so here. The robot starts at the origin, heading along +x; y is to its left.
"""

from dataclasses import dataclass
from math import pi

SENSOR_NAMES = ("camera", *(f"proximeter_{k}" for k in range(6)))
COMMAND_NAMES = ("left_track", "right_track", "elevation", "tilt", "magnet")
COMMAND_UNITS = ("m/s", "m/s", "m", "rad", "on above 0.5")
SENSOR_RANGES = (2.0, *6 * (1.0,))  # camera −1 … 1, proximeters 0 … 1

GRAVITY = 9.81


@dataclass(frozen=True)
class PlaneParams:
    """What is fixed for a run.

    Of these `motor_unit`, `dithering`, `battery` and `sensor_noise` can be told anew for each
    world as it is started; what stands here is for worlds that are told nothing.
    """

    # Time
    control_period: float = 0.1  # s; assumption
    # Physics steps per control step. In pushes, sweeps and grasps cubes end within 0.3 mm and
    # 0.4° of where 160 steps bring them (medians; the alignment of a grasp within 0.1 mm):
    # experiments/benchmarks/substeps.py
    substeps: int = 5
    time_limit: float = 180.0  # s; paper: Fs is a run of more than 3 minutes

    # Robot: marXbot
    hull_radius: float = 0.085  # Enki, ARGoS
    mass: float = 1.6  # kg; ARGoS
    track_separation: float = 0.15  # Enki
    top_speed: float = 0.30  # m/s; Enki
    wheel_noise: float = 0.02  # each track's speed ± this share, uniform; Enki
    motor_unit: float = 0.005  # m/s; the paper says "relatively low resolution"; assumption
    dithering: bool = False  # whole units by chance, the mean unchanged; § 3's proposal
    traction: float = 0.6  # tracks on floor, friction coefficient; assumption

    # Gripper, in front of the hull, with the magnet's face at its end; all assumptions
    reach: float = 0.135  # of the magnet's face from the robot's centre
    gripper_width: float = 0.064
    head: float = 0.02  # the head extends by this much above and below its middle
    low: float = 0.03  # height of its middle with the gripper down: the middle of the cube
    high: float = 0.12  # … and up
    scanning_tilt: float = pi / 2  # proximeters look ahead, the magnet down
    grasping_tilt: float = 0.2  # the magnet counts as facing ahead below this

    # Servos, controlled in position (paper); speed proportional to the battery's voltage (paper).
    # All values are assumptions.
    battery: float = 1.0  # voltage as a share of a full battery's
    elevation_speed: float = 0.03  # m/s on a full battery
    tilt_speed: float = 0.8  # rad/s on a full battery
    elevation_resolution: float = 0.0005  # m; set points are rounded to multiples of it
    tilt_resolution: float = 0.01  # rad
    elevation_dead_band: float = 0.001  # m; a servo this close to its set point stays
    tilt_dead_band: float = 0.02  # rad
    servo_restart: float = 0.05  # s that a servo stands after its set point changed

    # Magnet; all assumptions
    magnet_gap: float = 0.003  # largest gap to the cube's face that it closes
    magnet_angle: float = pi / 12  # largest angle to that face
    magnet_offset: float = 0.02  # lateral distance to the face's centre where all hold is gone
    magnet_force: float = 0.5  # N, centred
    magnet_radius: float = 0.01  # lever of its hold against tipping and turning
    lift: float = 0.03  # a cube raised by this much is lifted

    # Cube
    side: float = 0.06  # assumption
    cube_mass: float = 0.005  # kg; polystyrene, 15–30 kg/m³
    floor_friction: float = 0.4  # cube on floor; assumption
    contact_friction: float = 0.5  # cube on robot; assumption

    # Sensors
    sensor_noise: float = 1.0  # scales all that follows

    # Camera above the robot's centre
    camera_height: float = 0.10  # assumption: below the raised head, above the lowered one
    field_of_view: float = pi * 70 / 180  # assumption: the whole set of positions is in view
    image_width: int = 640  # px; ARGoS
    camera_noise: float = 1.5  # px, standard deviation; assumption

    # Infrared proximeters on the gripper head, side by side, looking ahead when it scans
    proximeter_offsets: tuple[float, ...] = (0.030, 0.018, 0.006, -0.006, -0.018, -0.030)
    proximeter_range: float = 0.09  # m; end of Enki's curve, see sensors.infrared
    beam_half_angle: float = pi * 8 / 180  # assumption
    beam_rays: int = 5
    beam_steepest: float = pi / 4  # pointing up by more, light glances off; assumption
    proximeter_noise: float = 0.03  # response ± this share, uniform; Enki

    # Experimental area: the robot's hull crossing its border ends a run; assumption
    area: tuple[float, float, float, float] = (-0.25, 0.75, -0.35, 0.35)  # x, x, y, y

    @property
    def max_steps(self) -> int:
        """Control steps within the time limit."""
        return round(self.time_limit / self.control_period)
