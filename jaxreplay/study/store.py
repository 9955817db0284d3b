"""A study on disk: a manifest, and one netCDF file for each finished shard of its runs.

Files are written completely or not at all. A killed process leaves at most a `.part` file, which
nothing reads, and keeps every finished shard.
"""

import hashlib
import json
import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxreplay.errors import ConfigError
from jaxreplay.machine import write_whole
from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import PlaneParams
from jaxreplay.study import parse
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.runs import Demonstrations
from jaxreplay.study.worlds.plane import PLANE_FACTORS

try:
    import fcntl
except ImportError:  # Windows, where two processes in one folder are not kept apart
    fcntl = None

# Part of a study's identity; to be raised whenever the same config gives other results
# (tests/study/test_golden.py fails then).
# Folders of another number can be read, but not continued.
RESULTS_FORMAT = 2
MANIFEST, LOCK, SHARDS = "study.json", "study.lock", "shards"
_LIBRARIES = ("jax", "jaxlib", "numpy", "pymunk", "gymnasium")
_VERSIONS = "versions"  # for information; they do not belong to the identity


def manifest_of(
    config: StudyConfig, demonstrations: Demonstrations, shard_size: int
) -> dict[str, Any]:
    """Return the identity of a study: all that determines its results, and a hash of it.

    Args:
        config: the study.
        demonstrations: the records.
        shard_size: runs per shard; stored as `shard`.
    """
    content = hashlib.sha256()
    for records in demonstrations.values():
        for array in (records.nodes, records.commands, records.lengths, records.offset):
            content.update(np.ascontiguousarray(array).tobytes())
    file = parse.plain(config.demonstrations)
    settings: dict[str, Any] = asdict(config) | {"demonstrations": "" if file is None else file}
    # What a study does not use is left out, so that a new kind of factor or world changes no
    # existing study.
    settings["fixed"] = {name: v for name, v in config.fixed.items() if v is not None}
    plane = settings.pop("plane")
    unused = ("environment", "success_return") if config.environment is None else ("positions",)
    for name in unused:
        del settings[name]
    identity: dict[str, Any] = {
        "config": settings,
        "demonstrations": content.hexdigest(),
        "dtype": str(next(iter(demonstrations.values())).nodes.dtype),
        "shard": shard_size,
        "format": RESULTS_FORMAT,
    }
    if config.environment is None:
        identity["plane"] = {n: v for n, v in plane.items() if n not in SETTINGS}
    identity = json.loads(json.dumps(identity))  # as it will be read again
    return identity | {
        "hash": hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest(),
        _VERSIONS: {name: version(name) for name in _LIBRARIES},
    }


def check_format(folder: Path) -> None:
    """Check that this version can continue the study in a folder, if any, and repeat its runs.

    Raises:
        ConfigError: its results are of another `RESULTS_FORMAT`.
    """
    try:
        made = read_manifest(folder).get("format", 0)
    except (FileNotFoundError, ValueError):
        return
    if made != RESULTS_FORMAT:
        raise ConfigError(
            f"{folder} contains a study of results format {made}; this version of jaxreplay makes "
            f"format {RESULTS_FORMAT} and cannot continue it or repeat its runs (show and plot "
            "still work): run the study in another folder, with --out"
        )


@contextmanager
def claimed(folder: Path, manifest: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Reserve a folder for this process and a study; yield the manifest stored there.

    The manifest is written if there is none; one that is damaged is renamed first. One that was
    written before a factor or a constant existed is of the same study where this has its default.

    Raises:
        ConfigError: it contains another study (the message lists the differences), or another
            process is running in it.
    """
    (folder / SHARDS).mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as lock:
        if fcntl:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ConfigError(
                    f"{folder}: another process is running this study; wait, or give another --out"
                ) from None
        try:
            stored = read_manifest(folder)
        except FileNotFoundError:
            stored = None
        except ValueError:
            set_aside(folder / MANIFEST)
            stored = None
        if stored is None:
            write_whole(folder / MANIFEST, json.dumps(manifest, indent=1).encode())
        elif differs := _differences(_completed(stored, manifest), manifest):
            raise ConfigError(
                f"{folder} contains another study, which differs in {', '.join(differs)}; give "
                "another --out"
            )
        yield stored or manifest


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of the study in a folder.

    Raises:
        FileNotFoundError: there is none.
        ValueError: the file is truncated, or no manifest.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise FileNotFoundError(
            f"no study in {folder}: {MANIFEST} is missing; jaxreplay run makes it"
        )
    try:
        manifest = json.loads(path.read_text())
        if manifest["hash"] and manifest["config"]:
            return manifest
    except (ValueError, KeyError, TypeError):
        pass
    raise ValueError(f"{path} is not the manifest of a study (truncated?)")


def read_shard(
    folder: Path, k: int, manifest: dict[str, Any], names: Iterable[str]
) -> xr.Dataset | None:
    """Return the named variables of a shard; None if it is missing, damaged or of another study."""
    path = _path(folder, k)
    try:
        with xr.open_dataset(path, engine="scipy") as dataset:
            dataset = dataset.load()
        return dataset[list(names)] if dataset.attrs["study"] == manifest["hash"] else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError):
        return None


def write_shard(folder: Path, k: int, manifest: dict[str, Any], dataset: xr.Dataset) -> None:
    """Store a finished shard; an unreadable file in its place is renamed, not lost."""
    path = _path(folder, k)
    if path.exists():
        set_aside(path)
    dataset = dataset.assign_attrs(study=manifest["hash"])
    write_whole(path, bytes(dataset.to_netcdf(engine="scipy")))


def set_aside(path: Path) -> None:
    """Rename a damaged file to `PATH.bad`, and warn."""
    aside = path.with_suffix(f"{path.suffix}.bad")
    os.replace(path, aside)
    warnings.warn(f"{path} is damaged or not of this study; kept as {aside.name}", stacklevel=2)


def _path(folder: Path, k: int) -> Path:
    return folder / SHARDS / f"{k:05d}.nc"


def _completed(stored: dict[str, Any], wanted: dict[str, Any]) -> dict[str, Any]:
    """Return a manifest with defaults for the factors and constants that it does not know."""
    config, plane = stored["config"], asdict(PlaneParams())
    new = set(wanted["config"]["fixed"]) - {*config["fixed"], *config["axes"]}
    defaults = {n: PLANE_FACTORS[n].default for n in new if n in PLANE_FACTORS}
    completed = {"config": config | {"fixed": defaults | config["fixed"]}}
    if "plane" in stored and "plane" in wanted:
        constants = {name: plane[name] for name in wanted["plane"]} | stored["plane"]
        completed["plane"] = json.loads(json.dumps(constants))
    return stored | completed


def _differences(stored: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """Return the keys, dotted, whose values differ."""
    found = []
    for key in sorted({*stored, *wanted} - {"hash", _VERSIONS}):
        a, b = stored.get(key), wanted.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            found += [f"{key}.{name}" for name in _differences(a, b)]
        elif a != b:
            found.append(key)
    return found
