"""The plane as a Gymnasium vector environment: B worlds that advance together."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from jaxreplay.plane.actuators import (
    Settings,
    elevation_servo,
    holding_force,
    lowest_elevation,
    magnet_to_face,
    tilt_servo,
    tips,
    track_speeds,
)
from jaxreplay.plane.options import SETTINGS, parse_options, seeds_of
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.sensors import Pose, camera, proximeters
from jaxreplay.plane.stall import STALL_SECONDS, stall
from jaxreplay.plane.start import push_speeds, start_of
from jaxreplay.plane.worlds import Worlds

METADATA = {"render_modes": ["rgb_array"], "render_fps": 10}


def _spaces(params: PlaneParams) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Return the spaces of one world's observations and actions."""
    top = params.top_speed
    observations = gymnasium.spaces.Box(
        np.array([-1] + 6 * [0], np.float32), np.ones(7, np.float32)
    )
    actions = gymnasium.spaces.Box(
        np.array([-top, -top, params.low, 0, 0], np.float32),
        np.array([top, top, params.high, params.scanning_tilt, 1], np.float32),
    )
    return observations, actions


class PlaneVectorEnv(gymnasium.vector.VectorEnv):
    """B robots, each with a cube to fetch, that advance together.

    **Observation** `[B, 7]` float32: the cube's x in the camera image, −1 … 1, and six
    proximeters, 0 … 1.
    **Action** `[B, 5]`: speeds of the left and right track (m/s; the robot runs them at whole
    motor units), set points of elevation (m) and tilt (rad), magnet (on above 0.5). Actions
    beyond an actuator's limits are clipped.
    **Reward** `[B]`: 1 while the cube is held and lifted, else 0. That does not end the run: a
    robot may still release the cube.
    **Terminated** `[B]`: the hull crosses the border of the experimental area. **Truncated**
    `[B]`: the time limit (3 minutes) is over. A world that has ended rests until it is reset:
    it stands still and is not simulated. The caller can make worlds rest by setting `resting`.
    **Info**, `[B]` each: `is_success`, whether the cube is held and lifted; `was_lifted`, whether
    it has been at any time; `alignment_error`, the lateral distance (m) from the magnet's centre
    to that of the face that it last grasped, NaN before the first grasp; `stall`, "fixed",
    "cyclic" or "slow" where the run is truncated, else empty.

    **Reset** restarts all worlds, or those marked in `options["reset_mask"]` (`[B]` bool). A
    restarted world behaves as if it were new and the only one: all randomness in it comes from
    its own seed. Other options, each with one value per slot: `cube` `[B, 3]`, x, y (m) and angle
    (rad), and the settings, see :class:`jaxreplay.plane.actuators.Settings`. Without `cube`, a
    cube is placed at random 25–40 cm ahead and up to 10 cm to either side, with a face turned to
    the robot.

    Attributes:
        params: the constants.
        control_period: s of a step.
        pose: where robots, cubes and grippers are, see :class:`Pose`.
        held: `[B]` bool, whether the magnet holds the cube.
        alignment_error: `[B]` in m, as in the info.
        resting: `[B]` bool, the worlds that rest.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.DISABLED}

    def __init__(
        self,
        num_envs: int = 1,
        params: PlaneParams | None = None,
        render_mode: str | None = None,
    ):
        """Create B slots; `reset` puts worlds into them.

        Args:
            num_envs: B, the number of slots.
            params: the constants; the defaults of :class:`PlaneParams` if None.
            render_mode: `"rgb_array"` or None; `render` returns pictures in either case.
        """
        self.num_envs, self.render_mode = num_envs, render_mode
        self.params = p = params or PlaneParams()
        self.control_period, n = p.control_period, num_envs
        self.single_observation_space, self.single_action_space = _spaces(p)
        self.observation_space, self.action_space = (
            gymnasium.vector.utils.batch_space(space, n)
            for space in (self.single_observation_space, self.single_action_space)
        )
        self._servos = elevation_servo(p), tilt_servo(p)
        self._worlds = Worlds(p, n)  # empty slots rest
        self.pose = Pose(np.zeros((n, 3)), np.zeros((n, 3)), np.full(n, p.high), np.zeros(n))
        self._set_points = np.zeros((n, 2))
        self._gain, self._push = np.ones((n, 2)), np.zeros((n, 3))
        self.held, self._grasped_at = np.zeros(n, bool), np.zeros((n, 2))  # lateral, elevation; m
        self.alignment_error, self.resting = np.full(n, np.nan), np.ones(n, bool)
        self._was_lifted = np.zeros(n, bool)
        self._gripper_above, self._off_floor = np.zeros((2, n), bool)
        self._camera = np.zeros(n)
        self._observations = np.zeros((n, 7))
        self._step = np.zeros(n, int)
        self._settings = Settings(*(np.full(n, getattr(p, name), float) for name in SETTINGS))
        # All noise of a world is drawn when it starts, so that it depends on its seed and step
        # alone. Columns: wheel noise 2, dithering 2, camera 1, proximeters 6.
        self._noise = np.zeros((n, p.max_steps + 1, 11))
        self._trail = np.zeros((n, round(STALL_SECONDS / p.control_period), 5))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Restart worlds and return all observations `[B, 7]` and the info, see the class.

        Args:
            seed: one seed for each slot, None for a drawn one; or one whole number s, for the
                seeds s, s + 1, …
            options: see the class.

        Raises:
            ValueError: an option is unknown, has the wrong shape or is out of range, or there is
                not one seed for each slot. No world is changed then.
        """
        n = self.num_envs
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", np.ones(n, bool)))
        if mask.shape != (n,) or mask.dtype != bool:
            raise ValueError(f"reset_mask must be {n} booleans; got {mask.dtype} {mask.shape}")
        cubes, settings = parse_options(options, n, self.params)
        seeds = seeds_of(seed, n)
        super().reset(seed=int(seed) if isinstance(seed, int | np.integer) else None)
        for b in np.flatnonzero(mask).tolist():
            chosen = self.np_random.integers(2**63) if (own := seeds[b]) is None else own
            self._start_world(b, int(chosen), cubes[b], settings)
        self._observe(mask)
        return self._observations.astype(np.float32), self._info()

    def _start_world(self, b: int, seed: int, cube: np.ndarray, settings: Settings) -> None:
        """Put a new world into slot b, with the cube `[3]`, at random where that is NaN."""
        p = self.params
        placing, noisy = (np.random.default_rng([seed, k]) for k in range(2))
        if np.isnan(cube).any():
            x, y = placing.uniform([0.25, -0.1], [0.40, 0.1])
            cube = np.array([x, y, np.arctan2(y, x)])
        self._noise[b] = noisy.uniform(-1, 1, self._noise[b].shape)
        self._noise[b, :, 2:4] = (self._noise[b, :, 2:4] + 1) / 2
        self._noise[b, :, 4] = noisy.standard_normal(len(self._noise[b]))
        for current, new in zip(self._settings, settings, strict=True):
            current[b] = new[b]
        start = start_of(self._settings, b, seed, cube)
        self._worlds.put(b, start.cube, start.robot)
        self._gain[b], self.pose.robot[b], self.pose.cube[b], self._push[b] = start
        self.pose.elevation[b], self.pose.tilt[b] = p.high, 0.0
        self._set_points[b] = p.high, 0.0
        self.held[b] = self._gripper_above[b] = self._off_floor[b] = self.resting[b] = False
        self._was_lifted[b] = False
        self.alignment_error[b] = np.nan
        self._camera[b] = self._step[b] = 0

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Carry out one control step in all worlds that do not rest.

        Returns:
            Observations `[B, 7]`, rewards, terminated, truncated (`[B]` each) and the info.

        Raises:
            ValueError: the actions are not `[B, 5]`, or not finite.
            ResetNeeded: `reset` has not been called (an error of Gymnasium's).
        """
        actions = np.asarray(actions, float)
        if actions.shape != (self.num_envs, 5) or not np.isfinite(actions).all():
            raise ValueError(
                f"actions must be {self.num_envs} × 5 finite numbers; got {actions.shape} "
                f"with {np.sum(~np.isfinite(actions))} not finite"
            )
        if not self._worlds:
            raise gymnasium.error.ResetNeeded("call reset before step: there are no worlds yet")
        p, going = self.params, ~self.resting
        noise = self._noise[np.arange(self.num_envs), self._step]
        self._move_gripper(actions, going)
        speeds = track_speeds(
            p, self._settings, self._gain, actions[:, :2], noise[:, 2:4], noise[:, :2]
        )
        speeds += push_speeds(self._push, self._step * p.control_period)
        forward = speeds.mean(axis=1)
        turn = (speeds[:, 1] - speeds[:, 0]) / p.track_separation
        self._worlds.advance(going, forward, turn, self.pose)
        self._grasp(going & (actions[:, 4] > 0.5), going & (actions[:, 4] <= 0.5))

        at = self._step % self._trail.shape[1]
        gripper = np.stack([self.pose.elevation, self.pose.tilt], axis=1)
        self._trail[np.arange(self.num_envs), at] = np.hstack([self.pose.robot, gripper])
        self._was_lifted |= going & self.lifted
        self._step[going] += 1
        self._observe(going)
        terminated = self.outside & going
        truncated = (self._step == p.max_steps) & going & ~terminated
        self.resting |= terminated | truncated
        reward = np.where(going & self.lifted, 1.0, 0.0)
        return (
            self._observations.astype(np.float32),
            reward,
            terminated,
            truncated,
            self._info(truncated),
        )

    @property
    def lifted(self) -> np.ndarray:
        """`[B]` bool, whether the cube is held and raised by the height that counts as lifted."""
        return self.held & (self.pose.elevation >= self._grasped_at[:, 1] + self.params.lift)

    @property
    def outside(self) -> np.ndarray:
        """`[B]` bool, whether the robot's hull crosses the border of the experimental area."""
        (x, y), r = self.pose.robot[:, :2].T, self.params.hull_radius
        x0, x1, y0, y1 = self.params.area
        return (x - r < x0) | (x + r > x1) | (y - r < y0) | (y + r > y1)

    def render(self) -> tuple[np.ndarray, ...]:
        """Return a picture of each world from above, `[H, W, 3]` uint8."""
        from jaxreplay.plane.drawing import picture

        each = (Pose(*(x[b : b + 1] for x in self.pose)) for b in range(self.num_envs))
        return tuple(
            picture(self.params, pose, held) for pose, held in zip(each, self.held, strict=True)
        )

    def _move_gripper(self, actions: np.ndarray, going: np.ndarray) -> None:
        """Move elevation and tilt of the worlds that are simulated (`going`, `[B]`)."""
        p, pose = self.params, self.pose
        floor = np.where(self.held, p.low, lowest_elevation(p, pose))
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
        for b, world in self._worlds.of(going & (above != self._gripper_above)):
            world.set_gripper_above(above[b])
        self._gripper_above[going] = above[going]

    def _grasp(self, on: np.ndarray, off: np.ndarray) -> None:
        """Attach cubes to the magnets that touch them, and release those that cannot be held.

        Args:
            on: `[B]` worlds that are simulated with the magnet on.
            off: `[B]` worlds that are simulated with the magnet off.
        """
        p, pose = self.params, self.pose
        gap, lateral, angle = magnet_to_face(p, pose)
        force = holding_force(p, lateral, angle)
        at, raised = self._grasped_at[:, 0], pose.elevation > self._grasped_at[:, 1]
        slipped = np.hypot(gap, lateral - at) > p.magnet_gap
        turned = np.abs(angle) > p.magnet_angle
        going = on | off
        lost = off | slipped | turned | (pose.tilt >= p.grasping_tilt)
        lost |= raised & tips(p, holding_force(p, at, 0.0))
        lost &= self.held & going
        for _, world in self._worlds.of(lost):
            world.release()
        self.held &= ~lost

        ready = on & ~self.held & ~lost & (pose.tilt < p.grasping_tilt)
        ready &= pose.elevation < p.low + p.side / 2
        ready &= (gap < p.magnet_gap) & (gap > -p.side / 2)
        ready &= force > 0
        for b, world in self._worlds.of(ready):
            world.attach(force[b], force[b] * p.magnet_radius)
            self._grasped_at[b] = lateral[b], pose.elevation[b]
        self.alignment_error[ready] = np.abs(lateral[ready])
        self.held |= ready

        off_floor = self.held & (pose.elevation > self._grasped_at[:, 1])
        for b, world in self._worlds.of(off_floor != self._off_floor):
            world.set_cube_off_floor(off_floor[b])
        self._off_floor = off_floor

    def _observe(self, mask: np.ndarray) -> None:
        """Update the observations of the worlds in the mask `[B]`."""
        p = self.params
        noise = self._noise[np.arange(self.num_envs), self._step, 4:]
        noise *= self._settings.sensor_noise[:, None]
        seen = camera(p, self.pose, self._camera, p.camera_noise * noise[:, 0])
        near = proximeters(p, self.pose, p.proximeter_noise * noise[:, 1:])
        self._camera[mask] = seen[mask]
        self._observations[mask] = np.column_stack([seen, near])[mask]

    def _info(self, truncated: np.ndarray | None = None) -> dict[str, Any]:
        """Return the info of all worlds, with the stalls of those truncated (`[B]`)."""
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
            "was_lifted": self._was_lifted.copy(),
            "alignment_error": self.alignment_error.copy(),
            "stall": stalls,
        }
        present = {f"_{name}": np.ones(n, bool) for name in info}  # Gymnasium's convention
        return info | present | {"_alignment_error": np.isfinite(self.alignment_error)}
