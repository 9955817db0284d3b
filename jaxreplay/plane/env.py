"""The plane as a Gymnasium vector environment: B worlds in slots."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from jaxreplay.plane.actuators import (
    Settings,
    elevation_servo,
    magnet_hold,
    magnet_to_face,
    rests_on_cube,
    tilt_servo,
    tips,
    track_speeds,
)
from jaxreplay.plane.options import SETTINGS, seeds_of, told
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose, camera, proximeters
from jaxreplay.plane.stall import STALL_SECONDS, stall
from jaxreplay.plane.stepping import advance
from jaxreplay.plane.world import World

METADATA = {"render_modes": ["rgb_array"], "render_fps": 10}


def _spaces(params: PlaneParams) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    top = params.top_speed
    seen = gymnasium.spaces.Box(np.array([-1] + 6 * [0], np.float32), np.ones(7, np.float32))
    sent = gymnasium.spaces.Box(
        np.array([-top, -top, params.low, 0, 0], np.float32),
        np.array([top, top, params.high, params.scanning_tilt, 1], np.float32),
    )
    return seen, sent


class PlaneVectorEnv(gymnasium.vector.VectorEnv):
    """B robots, each with a cube to fetch, advancing together.

    **Observation** `[B, 7]`: the cube's x in the image, and six proximeters.
    **Action** `[B, 5]`: left and right track (m/s; the robot runs them at whole motor units),
    set points of elevation (m) and tilt (rad), magnet (on above 0.5). Beyond an actuator's
    limits they are clipped.
    **Reward**: 1 while the cube is held and lifted. That is no end: a robot may still let go.
    **Terminated**: the hull crosses the border of the experimental area. **Truncated**: the time
    limit (3 minutes) is over. A world that ended rests until it is reset, and so does one that
    the caller puts into `resting`: it stands still and costs nothing.
    **Info**: `is_success` (the cube is held and lifted), `alignment_error` (lateral distance
    from the magnet's centre to the centre of the face it took hold of, m; not told before) and
    `stall` ("fixed", "cyclic" or "slow" once truncated, else empty).

    **Reset** restarts all worlds or those in `options["reset_mask"]`, in a slot as if alone and
    new. Other options, each with a value per slot: `cube` `[B, 3]` x, y (m) and angle (rad);
    `motor_unit` (m/s), `dithering`, `battery` (share of the full voltage), `sensor_noise`
    (factor). A cube not told of is laid anywhere 25–40 cm ahead and within 10 cm aside, a face
    turned to the robot. All chance in a world comes from its own seed.

    Attributes:
        params: the constants.
        pose: where everything is, see :class:`Pose`.
        held: `[B]` whether the magnet holds the cube.
        alignment_error: `[B]`, as in the info.
        resting: `[B]` which worlds rest.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.DISABLED}

    def __init__(
        self,
        num_envs: int = 1,
        params: PlaneParams | None = None,
        render_mode: str | None = None,
    ):
        """B slots; `reset` puts worlds into them."""
        self.num_envs, self.render_mode = num_envs, render_mode
        self.params = params or PlaneParams()
        p, n = self.params, num_envs
        self.single_observation_space, self.single_action_space = _spaces(p)
        self.observation_space, self.action_space = (
            gymnasium.vector.utils.batch_space(space, n)
            for space in (self.single_observation_space, self.single_action_space)
        )
        self._servos = elevation_servo(p), tilt_servo(p)
        self._worlds: list[World | None] = [None] * n
        self.pose = Pose(np.zeros((n, 3)), np.zeros((n, 3)), np.full(n, p.high), np.zeros(n))
        self._set_points = np.zeros((n, 2))
        self.held = np.zeros(n, bool)
        self._taken = np.zeros((n, 2))  # lateral and elevation when taking hold
        self.alignment_error = np.full(n, np.nan)
        self.resting = np.ones(n, bool)
        self._above = np.zeros(n, bool)
        self._off_floor = np.zeros(n, bool)
        self._seen = np.zeros(n)
        self._observed = np.zeros((n, 7))
        self._step = np.zeros(n, int)
        self._settings = Settings(*(np.full(n, getattr(p, name), float) for name in SETTINGS))
        # Drawn as a world starts, so that its noise depends on nothing but its seed and step:
        # wheels 2, dithering 2, camera, proximeters 6.
        self._noise = np.zeros((n, p.max_steps + 1, 11))
        self._trail = np.zeros((n, round(STALL_SECONDS / p.control_period), 5))

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Restart worlds; see the class.

        Raises:
            ValueError: an option that is unknown, has the wrong shape or is out of range, or
                seeds that are not one for each slot.
        """
        n = self.num_envs
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", np.ones(n, bool)))
        if mask.shape != (n,) or mask.dtype != bool:
            raise ValueError(f"reset_mask must be {n} booleans; got {mask.dtype} {mask.shape}")
        cubes, settings = told(options, n, self.params)
        seeds = seeds_of(seed, n)
        super().reset(seed=int(seed) if isinstance(seed, int | np.integer) else None)
        for b in np.flatnonzero(mask):
            chosen = self.np_random.integers(2**63) if seeds[b] is None else seeds[b]
            self._start(b, int(chosen), cubes[b], settings)
        self._look(mask)
        return self._observed.astype(np.float32), self._info()

    def _start(self, b: int, seed: int, cube: np.ndarray, settings: Settings):
        p = self.params
        placing, noisy = (np.random.default_rng([seed, k]) for k in range(2))
        if np.isnan(cube).any():
            x, y = placing.uniform([0.25, -0.1], [0.40, 0.1])
            cube = np.array([x, y, np.arctan2(y, x)])
        self._noise[b] = noisy.uniform(-1, 1, self._noise[b].shape)
        self._noise[b, :, 2:4] = (self._noise[b, :, 2:4] + 1) / 2
        self._noise[b, :, 4] = noisy.standard_normal(len(self._noise[b]))
        for held, given in zip(self._settings, settings, strict=True):
            held[b] = given[b]
        self._worlds[b] = World(p, cube)
        self.pose.robot[b], self.pose.cube[b] = 0.0, cube
        self.pose.elevation[b], self.pose.tilt[b] = p.high, 0.0
        self._set_points[b] = p.high, 0.0
        self.held[b] = self._above[b] = self._off_floor[b] = self.resting[b] = False
        self.alignment_error[b] = np.nan
        self._seen[b] = self._step[b] = 0

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Carry out one control step in all worlds that don't rest, and observe.

        Raises:
            ValueError: the actions are not finite, or not `[B, 5]`.
        """
        actions = np.asarray(actions, float)
        if actions.shape != (self.num_envs, 5) or not np.isfinite(actions).all():
            raise ValueError(
                f"actions must be {self.num_envs} × 5 finite numbers; got {actions.shape} "
                f"with {np.sum(~np.isfinite(actions))} not finite"
            )
        p, going = self.params, ~self.resting
        noise = self._noise[np.arange(self.num_envs), self._step]
        self._move_gripper(actions, going)
        speeds = track_speeds(p, self._settings, actions[:, :2], noise[:, 2:4], noise[:, :2])
        forward = speeds.mean(axis=1)
        turn = (speeds[:, 1] - speeds[:, 0]) / p.track_separation
        for b in np.flatnonzero(going):
            moved = advance(self._worlds[b], forward[b], turn[b])
            self.pose.robot[b], self.pose.cube[b] = moved[:3], moved[3:]
        self._grasp(going & (actions[:, 4] > 0.5), going & (actions[:, 4] <= 0.5))

        at = self._step % self._trail.shape[1]
        gripper = np.stack([self.pose.elevation, self.pose.tilt], axis=1)
        self._trail[np.arange(self.num_envs), at] = np.hstack([self.pose.robot, gripper])
        self._step[going] += 1
        self._look(going)
        terminated = self.outside & going
        truncated = (self._step == p.max_steps) & going & ~terminated
        self.resting |= terminated | truncated
        reward = np.where(going & self.lifted, 1.0, 0.0)
        return (
            self._observed.astype(np.float32),
            reward,
            terminated,
            truncated,
            self._info(truncated),
        )

    @property
    def lifted(self) -> np.ndarray:
        """`[B]` whether the cube is held off the floor."""
        return self.held & (self.pose.elevation >= self._taken[:, 1] + self.params.lift)

    @property
    def outside(self) -> np.ndarray:
        """`[B]` whether the robot's hull crosses the border of the area."""
        (x, y), r = self.pose.robot[:, :2].T, self.params.hull_radius
        x0, x1, y0, y1 = self.params.area
        return (x - r < x0) | (x + r > x1) | (y - r < y0) | (y + r > y1)

    def render(self) -> tuple[np.ndarray, ...]:
        """A picture of each world from above, `[H, W, 3]` of bytes."""
        from jaxreplay.plane.drawing import picture

        each = (Pose(*(x[b : b + 1] for x in self.pose)) for b in range(self.num_envs))
        return tuple(
            picture(self.params, pose, held) for pose, held in zip(each, self.held, strict=True)
        )

    def _move_gripper(self, actions: np.ndarray, going: np.ndarray):
        p, pose = self.params, self.pose
        floor = np.where(self.held, p.low, rests_on_cube(p, pose))
        for k, (servo, position) in enumerate(
            zip(self._servos, (pose.elevation, pose.tilt), strict=True)
        ):
            moved, wanted = servo.move(
                position, self._set_points[:, k], actions[:, 2 + k], self._settings.battery,
                p.control_period,
            )  # fmt: skip
            if k == 0:
                moved = np.maximum(moved, floor)
            position[going], self._set_points[going, k] = moved[going], wanted[going]
        above = (pose.elevation - p.head >= p.side) & ~self.held
        for b in np.flatnonzero(going & (above != self._above)):
            self._worlds[b].raise_gripper(above[b])
        self._above[going] = above[going]

    def _grasp(self, on: np.ndarray, off: np.ndarray):
        """Let magnets take hold of what they touch, and let go of what they cannot hold."""
        p, pose = self.params, self.pose
        gap, lateral, angle = magnet_to_face(p, pose)
        force = magnet_hold(p, lateral, angle)
        at, raised = self._taken[:, 0], pose.elevation > self._taken[:, 1]
        slipped = np.hypot(gap, lateral - at) > p.magnet_gap
        turned = np.abs(angle) > p.magnet_angle
        going = on | off
        lost = off | slipped | turned | (pose.tilt >= p.grasping_tilt)
        lost |= raised & tips(p, magnet_hold(p, at, 0.0))
        lost &= self.held & going
        for b in np.flatnonzero(lost):
            self._worlds[b].release()
        self.held &= ~lost

        ready = on & ~self.held & ~lost & (pose.tilt < p.grasping_tilt)
        ready &= pose.elevation < p.low + p.side / 2
        ready &= (gap < p.magnet_gap) & (gap > -p.side / 2)
        ready &= force > 0
        for b in np.flatnonzero(ready):
            self._worlds[b].hold(force[b], force[b] * p.magnet_radius)
            self._taken[b] = lateral[b], pose.elevation[b]
        self.alignment_error[ready] = np.abs(lateral[ready])
        self.held |= ready

        off_floor = self.held & (pose.elevation > self._taken[:, 1])
        for b in np.flatnonzero(off_floor != self._off_floor):
            self._worlds[b].raise_cube(off_floor[b])
        self._off_floor = off_floor

    def _look(self, mask: np.ndarray):
        p = self.params
        noise = self._noise[np.arange(self.num_envs), self._step, 4:]
        noise *= self._settings.sensor_noise[:, None]
        seen = camera(p, self.pose, self._seen, p.camera_noise * noise[:, 0])
        near = proximeters(p, self.pose, p.proximeter_noise * noise[:, 1:])
        self._seen[mask] = seen[mask]
        self._observed[mask] = np.column_stack([seen, near])[mask]

    def _info(self, truncated: np.ndarray | None = None) -> dict[str, Any]:
        n = self.num_envs
        stalls = np.full(n, "", dtype="<U6")
        for b in np.flatnonzero(truncated) if truncated is not None else ():
            length, t = self._trail.shape[1], self._step[b]
            trail = (
                np.roll(self._trail[b], -t % length, axis=0) if t > length else self._trail[b, :t]
            )
            stalls[b] = stall(trail, self.params.control_period)
        info = {
            "is_success": self.lifted,
            "alignment_error": self.alignment_error.copy(),
            "stall": stalls,
        }
        told = {f"_{name}": np.ones(n, bool) for name in info}
        return info | told | {"_alignment_error": np.isfinite(self.alignment_error)}
