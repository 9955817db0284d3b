"""One open page: what it asks for is done one after the other, in a thread of its own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any

import numpy as np
import xarray as xr

from jaxreplay.errors import ConfigError
from jaxreplay.explore.cells import picture
from jaxreplay.explore.drive import KEYS, USED, Driver
from jaxreplay.explore.live import CancelledError, asked, controls, stream, titled, values_of
from jaxreplay.machine import keep_compiled
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import CUBE_X, CUBE_Y
from jaxreplay.records import Records
from jaxreplay.study.again import taught_in
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.demonstrations import demonstrations
from jaxreplay.study.open import config_of, open_study
from jaxreplay.study.runs import Demonstrations, runs_of, taught_by

DEFAULT = {"theta_i": 0.1}  # of a session without a study
MADE = Path("results/explore")  # where demonstrations are stored that the study does not have


class Session:
    """The state of one page, and the thread that works for it.

    A new wish ends what is going on: of messages from the page, all but `keys`, `order` and `save`.
    """

    def __init__(self, folder: Path | None, send: Callable[[dict[str, Any]], None]):
        """Start to work.

        Args:
            folder: of the study; None: the default study, which has no runs.
            send: called with each message, in the session's thread.
        """
        self._folder, self._to_page, self._number = folder, send, 0
        self._wishes: Queue[tuple[int, dict[str, Any] | None]] = Queue()
        self._driver: Driver | None = None
        self._records: dict[Any, Records] = {}  # by the robot that made them
        Thread(target=self._work, daemon=True).start()

    def receive(self, message: dict[str, Any]) -> None:
        """Take in a message of the page."""
        what = message.get("do")
        if what == "keys" and self._driver:
            self._driver.press(message.get("keys", []), message.get("pressed", []))
        elif what == "order" and self._driver:
            self._driver.order(f"{message.get('order')}")
        elif what == "save" and self._driver:
            try:
                told = self._driver.save(f"{message.get('name')}")
                self._to_page({"kind": "saved", "text": told})
            except (ConfigError, OSError) as error:
                self._say(f"{error}")
        elif what in ("ask", "play", "drive", "stop"):
            self._number += 1
            self._wishes.put((self._number, message))

    def close(self) -> None:
        """End the thread."""
        self._number += 1
        self._wishes.put((self._number, None))

    def _say(self, text: str) -> None:
        self._to_page({"kind": "say", "text": text})

    def _work(self) -> None:
        """Do what is wished for, until the page is closed."""
        keep_compiled()
        try:
            self._open()
        except Exception as error:  # of a user's environment, too
            self._say(f"{error}")
            return
        while True:
            number, wish = self._wishes.get()
            if wish is None:
                return
            if number != self._number:
                continue  # there is a newer one
            try:
                self._do(wish, number)
            except CancelledError:
                pass
            except Exception as error:  # of a user's environment or controller, too
                what = "" if isinstance(error, ConfigError) else f"{type(error).__name__}: "
                if number == self._number:
                    self._to_page({"kind": "end", "ending": "an error", "note": f"{what}{error}"})

    def _open(self) -> None:
        """Read the study, and tell the page what there is."""
        self._study: xr.Dataset | None = None
        self._config = StudyConfig(fixed=DEFAULT)
        if self._folder is not None:
            self._study = open_study(self._folder)
            self._config = config_of(self._study)
        values = values_of(self._config, 0)
        self._to_page(
            {
                "kind": "hello",
                "study": None if self._study is None else picture(self._study),
                "folder": f"{self._folder or ''}",
                "controls": controls(self._config, values),
                "values": values,
                "cubes": [CUBE_X, CUBE_Y],
                "keys": KEYS if self._config.environment is None else None,
                "drive": USED,
            }
        )

    def _do(self, wish: dict[str, Any], number: int) -> None:
        def go() -> bool:
            return number == self._number

        def send(message: dict[str, Any]) -> None:
            if go():
                self._to_page(message)

        if wish["do"] == "drive":
            self._driver = self._driver or Driver(self._robot(), self._to_page)
            self._driver.demonstrate(go)
            return
        if wish["do"] == "play":
            k = int(wish["run"])
            values = values_of(self._config, k)
            send({"kind": "values", "values": values})
            title = f"run {k}: {titled(self._config, values)}"
            run = stream(self._config, self._taught(self._config, k), k, title, send, go)
            send({"kind": "end", "ending": run.ending, "note": self._compared(run.ending, k)})
        elif wish["do"] == "ask":
            config, k = asked(self._config, wish["values"])
            run = stream(config, self._taught(config, k), k, "a run as asked for", send, go)
            send({"kind": "end", "ending": run.ending, "note": ""})

    def _robot(self) -> PlaneParams:
        """Return the robot of the study's first run, which nobody pushes."""
        values = values_of(self._config, 0) | {"push": 0.0}
        return replace(self._config.plane, **{name: values[name] for name in SETTINGS})

    def _taught(self, config: StudyConfig, k: int) -> Demonstrations:
        """Return the records of a run; those of a robot that the study does not have are made."""
        one = runs_of(config).of(np.array([k]))
        robot = taught_by(config, one, 0)
        if not self._records and self._folder is not None:
            self._records.update(taught_in(self._folder, self._config))
        if robot not in self._records:
            self._say("the teacher demonstrates with this robot …")
            self._records.update(demonstrations(config, MADE))
            self._say("")
        return {robot: self._records[robot]}

    def _compared(self, ending: str, k: int) -> str:
        """Return whether a run ended as it did in the study."""
        assert self._study is not None
        stored = f"{self._study.outcome.values.ravel()[k]}"
        if not stored:
            return "this run is missing in the study"
        if ending.split(",")[0].split(" ")[0] == stored:
            return "as in the study"
        return f"in the study it ended as {stored}: another kind of processor, or version"
