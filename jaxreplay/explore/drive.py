"""Demonstrations by hand: the robot is driven with the keyboard, and its sensors are recorded."""

import re
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np

from jaxreplay.errors import ConfigError
from jaxreplay.page.run import curves, drawn_with, packed, pose_arrays
from jaxreplay.plane.env import PlaneVectorEnv
from jaxreplay.plane.options import seed_of
from jaxreplay.plane.params import COMMAND_NAMES, SENSOR_NAMES, PlaneParams
from jaxreplay.records import Records

# Keys, and what each adds to the speeds of the left and right track, in motor units.
TRACKS = {
    "w": (3, 3), "s": (-3, -3), "a": (-1, 1), "d": (1, -1),
    "arrowup": (3, 3), "arrowdown": (-3, -3), "arrowleft": (-1, 1), "arrowright": (1, -1),
}  # fmt: skip
GRIPPER, SCAN, MAGNET, SLOW = "r", "t", "m", "shift"  # each press of the first three switches
ORDERS = {"enter": "keep", "backspace": "discard"}
USED = (*TRACKS, GRIPPER, SCAN, MAGNET, SLOW, *ORDERS)
KEYS = (
    "w, s or ↑, ↓: ahead, back · a, d or ←, →: turn · shift: slowly · r: gripper up, down "
    "· t: scan, grasp · m: magnet · enter: keep · backspace: discard"
)
REST = 10  # samples at rest that end a demonstration, as a replay ends within a record's last 10

Send = Callable[[dict[str, Any]], None]


class Driver:
    """The robot under one's hands, and the demonstrations that were kept."""

    def __init__(self, params: PlaneParams, send: Send):
        """Prepare to drive; nothing moves yet.

        Args:
            params: of the plane.
            send: called with each message for the page.
        """
        self.params, self._send = params, send
        self.kept: list[tuple[np.ndarray, np.ndarray]] = []
        self._keys: set[str] = set()
        self._order = ""  # keep or discard
        self._switches = {GRIPPER: False, SCAN: False, MAGNET: False}
        self._begun = 0

    def press(self, keys: list[Any], pressed: list[Any]) -> None:
        """Take in the keys that are down, and those that were just pressed."""
        self._keys = {f"{key}".lower() for key in keys}
        for key in pressed:
            self._order = ORDERS.get(f"{key}".lower(), self._order)
            if (name := f"{key}".lower()) in self._switches:
                self._switches[name] = not self._switches[name]

    def order(self, what: str) -> None:
        """Keep or discard the demonstration that is going on."""
        self._order = what

    def demonstrate(self, go: Callable[[], bool]) -> None:
        """Let the robot be driven, at the control rate, until its run is kept or discarded.

        Args:
            go: whether driving is still wanted.
        """
        p, env = self.params, PlaneVectorEnv(1, self.params)
        self._begun += 1
        self._order, self._keys = "", set()
        self._switches = dict.fromkeys(self._switches, False)
        env.reset(seed=[seed_of(self._begun, 2)])
        rows: list[tuple[np.ndarray, np.ndarray]] = []
        self._send({"kind": "run", "run": self._about()})
        due, rest = monotonic(), REST
        while rest and not env.resting[0]:
            ends = self._order == "keep"
            if self._order == "discard" or not (go() or ends):
                break
            rest -= ends
            command = self.command(at_rest=ends)
            observation, *_ = env.step(command[None])
            rows.append((observation[0].copy(), command))
            arrays = {
                "step": np.array([len(rows)]),
                "jump": np.array([False]),
                "sensors": observation,
                "commands": command[None],
                **pose_arrays(p, env.pose, env.held),
            }
            self._send({"kind": "steps", "data": packed(arrays), "pictures": []})
            due += p.control_period
            sleep(max(0.0, due - monotonic()))
        if rest == 0:
            sensors, commands = zip(*rows, strict=True)
            self.kept.append((np.array(sensors), np.array(commands)))
        lifted = "lifted" if env.lifted[0] else "not lifted"
        how = "kept" if rest == 0 else "discarded" if self._order == "discard" else "stopped"
        if rest and env.resting[0]:
            how = (
                "discarded: it left the area" if env.outside[0] else "discarded: 3 minutes are over"
            )
        ending, kept = f"{how}, the cube is {lifted}", len(self.kept)
        self._send(
            {"kind": "end", "ending": ending, "note": f"{how}; {self.state()}", "kept": kept}
        )

    def command(self, at_rest: bool = False) -> np.ndarray:
        """Return the command of the keys that are down: `[5]`, as of the plane's actions."""
        p = self.params
        tracks = np.zeros(2)
        if not at_rest:
            tracks = sum((np.array(TRACKS[key]) for key in self._keys & TRACKS.keys()), tracks)
        units = np.sign(tracks) * np.ceil(np.abs(tracks) / 3) if SLOW in self._keys else tracks
        down, scan, on = self._switches.values()
        hand = [p.low if down else p.high, p.scanning_tilt if scan else 0.0, float(on)]
        return np.array([*(units * p.motor_unit), *hand])

    def state(self) -> str:
        """Return what was kept, in words."""
        seconds = ", ".join(f"{len(z) * self.params.control_period:.0f} s" for z, _ in self.kept)
        return f"{len(self.kept)} kept" + (f": {seconds}" if seconds else "")

    def save(self, name: str) -> str:
        """Save what was kept as `NAME.npz` in the current folder, and return what to do with it.

        Raises:
            ConfigError: nothing was kept, the name is no file's name, or the file exists.
        """
        path = Path(f"{name}.npz")
        if not self.kept:
            raise ConfigError("no demonstration has been kept: drive, then press enter")
        if not re.fullmatch(r"[\w-]{1,60}", name):
            raise ConfigError("give a name of letters, digits, - and _")
        if path.exists():
            raise ConfigError(f"{path} exists; choose another name")
        sensors, commands = zip(*self.kept, strict=True)
        period = self.params.control_period
        records = Records.from_sequences(sensors, commands, SENSOR_NAMES, COMMAND_NAMES, period)
        records.save(path)
        return (
            f"saved {len(self.kept)} in {path}: jaxreplay inspect {path}; jaxreplay new theta_i; "
            f"jaxreplay run theta_i.toml --set demonstrations={path} --out results/{name}"
        )

    def _about(self) -> dict[str, Any]:
        """Return what the script has to know of a drive; it has no belief."""
        p = self.params
        return {
            "title": f"demonstration {len(self.kept) + 1}", "place": "",
            "period": p.control_period, "unit": "s", "taus": 0, "rows": [], "ends": [], "end": 60.0,
            "whose": "", "plane": drawn_with(p), "pictures": [],
            "sensors": curves(np.array([[-1.0] + 6 * [0.0], 7 * [1.0]]), SENSOR_NAMES),
            "commands": curves(np.zeros((1, 5)), COMMAND_NAMES, p),
        }  # fmt: skip
