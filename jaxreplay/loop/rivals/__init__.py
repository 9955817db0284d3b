"""Rivals of the filter: other controllers of a closed loop, made from the same records.

Each is a :class:`jaxreplay.loop.controller.Controller`. Its settings are chosen on the records
alone. Sensors are divided by their range in the records, so that all count alike.
"""

from importlib import import_module
from typing import cast

from jaxreplay.errors import ConfigError, suggest
from jaxreplay.loop.controller import MakeController

# By name: where each controller is, as "module:name".
CONTROLLERS: dict[str, str] = {
    "filter": "jaxreplay.loop.controller:FilterController",
    "tape": "jaxreplay.loop.rivals.tape:Tape",
    "nearest": "jaxreplay.loop.rivals.nearest:Nearest",
    "nearest_recent": "jaxreplay.loop.rivals.nearest:NearestRecent",
    "nearest_timed": "jaxreplay.loop.rivals.nearest:NearestTimed",
    "cloning": "jaxreplay.loop.rivals.cloning:Cloning",
    "regression": "jaxreplay.loop.rivals.regression:Regression",
}
_EXTRA = {"sklearn", "gmr", "threadpoolctl"}  # what the extra `rivals` installs


def controller_named(name: str) -> MakeController:
    """Return the constructor of a controller, imported on demand.

    Args:
        name: one of :data:`CONTROLLERS`, or `"module:name"` of a user's own.

    Raises:
        ConfigError: the name is unknown, its module cannot be imported or does not contain it, it
            cannot be called, or the extra `rivals` is not installed.
    """
    place = CONTROLLERS.get(name, name)
    module, colon, attribute = place.partition(":")
    if not (module and colon and attribute):
        raise ConfigError(
            f'no controller {suggest(name, CONTROLLERS)}; one of your own is "module:name"'
        )
    try:
        made = getattr(import_module(module), attribute)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in _EXTRA:
            raise ConfigError(
                f"controller {name} needs {error.name}: pip install 'jaxreplay[rivals]'"
            ) from None
        raise ConfigError(f"controller {name}: {error}") from None
    except AttributeError:
        raise ConfigError(f"controller {name}: {module} does not contain {attribute}") from None
    except Exception as error:  # a user's module may raise anything
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        raise ConfigError(f"controller {name}: {module} cannot be imported: {cause}") from None
    if not callable(made):
        raise ConfigError(f"controller {name}: {attribute} of {module} cannot be called")
    return cast(MakeController, made)
