"""HDF5, as robomimic and Minari store their datasets."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxreplay.errors import ConfigError, suggest
from jaxreplay.recordings.formats.recording import (
    Columns,
    Recording,
    Wanted,
    gather,
    labels,
    library,
    select,
)

Datasets = dict[str, Any]  # the name that a user sees → a dataset of HDF5


def read_hdf5(path: Path, wanted: Wanted) -> Recording:
    """Return the episodes in a file, in the order of their numbers.

    robomimic: `data/demo_0/obs/KEY` are the sensors by default, `data/demo_0/actions` the commands,
    and the rate is the `control_freq` of `env_args`. Minari: `episode_0/observations` and
    `episode_0/actions`, arrays or groups. By default, a row's observation is made before its
    action. Images and other arrays of more than 2 dimensions are left out.

    Raises:
        ConfigError: a name is unknown in the file or in an episode, h5py is not installed, or the
            file has neither layout.
    """
    h5py = library("h5py", "hdf5")
    if wanted.episode is not None:
        raise ConfigError(f"{path}: its groups are its episodes; leave the column of episodes out")
    try:
        file = h5py.File(path, "r")
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder") from None
    except OSError as error:
        raise ConfigError(f"{path}: is not a whole HDF5 file: {error}") from None
    with file:
        demos = _episodes(file.get("data"), "actions")
        if demos:
            columns, period = _robomimic, _control_period(file["data"])
        else:
            demos, columns, period = _episodes(file, "observations"), _minari, None
        if not demos:
            raise ConfigError(
                f"{path}: has neither data/demo_0/actions (robomimic) nor episode_0/observations "
                f"(Minari), but {', '.join(map(repr, file)) or 'nothing'}; read it with h5py, and "
                "pass its arrays to jr.Records.from_steps"
            )
        return _read(path, wanted, demos, columns, period)


def _read(
    path: Path,
    wanted: Wanted,
    demos: list[Any],
    columns: Callable[[Any], tuple[Datasets, Datasets, list[str]]],
    period: float | None,
) -> Recording:
    observations, actions, sensors = columns(demos[0])
    commands = [name for name in actions if name.split("/")[0] == "actions"] or None
    selection = select(
        wanted, str(path), _named(observations), _named(actions), sensors or None, commands
    )
    episodes = []
    for demo in demos:
        observations, actions, _ = columns(demo)
        where = f"{path}, {demo.name.strip('/')}"
        seen = _loader(actions | observations, where)
        sent = _loader(observations | actions, where)
        time = None if wanted.time is None else seen(wanted.time)
        episodes.append(gather(selection, where, seen, sent, time, period))
    return Recording(selection, episodes, "before")


def _named(datasets: Datasets) -> Columns:
    return {n: labels(n, data.shape[1] if data.ndim == 2 else 0) for n, data in datasets.items()}


def _loader(datasets: Datasets, where: str) -> Callable[[str], Any]:
    def load(name: str) -> Any:
        if name not in datasets:
            raise ConfigError(f"{where}: no column is named {suggest(name, datasets)}")
        return datasets[name][()]

    return load


def _episodes(group: Any, needed: str) -> list[Any]:
    """Return the groups that contain something of a name, in the order of their numbers."""
    found = (
        [] if not hasattr(group, "values") else [g for g in group.values() if needed in _keys(g)]
    )
    return sorted(found, key=lambda g: [int(n) for n in re.findall(r"\d+", g.name)])


def _robomimic(demo: Any) -> tuple[Datasets, Datasets, list[str]]:
    """Return the datasets of observations, those of actions, and which are sensors by default."""
    obs = _datasets(demo["obs"]) if "obs" in demo else {}
    top = {name: data for name, data in _datasets(demo).items() if "/" not in name}
    actions = {name: top.pop(name) for name in ("actions",) if name in top}
    return top | obs, actions, [*obs]


def _minari(episode: Any) -> tuple[Datasets, Datasets, list[str]]:
    """Return the same for Minari; names in a group of observations stand without the group's."""
    every = _datasets(episode)
    seen, actions, others = {}, {}, {}
    for name, data in every.items():
        top = name.split("/")[0]
        if top == "observations":
            seen[name.removeprefix("observations/")] = data
        else:
            (actions if top == "actions" else others)[name] = data
    return others | seen, actions, [*seen]


def _datasets(group: Any, prefix: str = "") -> Datasets:
    """Return the datasets of numbers in a group with at most 2 dimensions, by their paths."""
    found: Datasets = {}
    for name, item in group.items():
        if hasattr(item, "items"):
            found |= _datasets(item, f"{prefix}{name}/")
        elif item.ndim in (1, 2) and item.dtype.kind in "biuf":
            found[f"{prefix}{name}"] = item
    return found


def _control_period(data: Any) -> float | None:
    """Return the time between rows that a robomimic dataset's description of its robot gives."""
    try:
        rate = json.loads(data.attrs["env_args"])["env_kwargs"]["control_freq"]
        return 1 / float(rate) if float(rate) > 0 else None
    except (KeyError, TypeError, ValueError):
        return None


def _keys(group: Any) -> list[str]:
    return [*group.keys()] if hasattr(group, "keys") else []
