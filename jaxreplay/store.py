"""A study on disk: a manifest, and one netCDF file for each finished shard of its runs.

Files are put in place whole. What a killed process leaves behind is as good as nothing, and
what it had finished is kept.
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

from jaxreplay.config import ConfigError, StudyConfig
from jaxreplay.plane.params import PlaneParams
from jaxreplay.records import Records

try:
    import fcntl
except ImportError:  # not on Windows, where two processes in one folder are not kept apart
    fcntl = None

MANIFEST, LOCK, SHARDS = "study.json", "study.lock", "shards"
_VERSIONS = "versions"  # told, but no reason to refuse


def manifest_of(config: StudyConfig, records: Records, shard: int) -> dict[str, Any]:
    """What decides the results of a study, and with what they were computed."""
    held = hashlib.sha256()
    for array in (records.nodes, records.commands, records.lengths, records.offset):
        held.update(np.ascontiguousarray(array).tobytes())
    told = asdict(config) | {"demonstrations": str(config.demonstrations or "")}
    # What is not said is left out, so that a study made before a factor was known stays the same.
    told["fixed"] = {name: value for name, value in told["fixed"].items() if value is not None}
    made_of = {
        "config": told,
        "plane": asdict(PlaneParams()),
        "demonstrations": held.hexdigest(),
        "dtype": str(records.nodes.dtype),
        "shard": shard,
        "jaxreplay": version("jaxreplay"),
    }
    made_of = json.loads(json.dumps(made_of))  # as it will be read again
    return made_of | {
        "hash": hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest(),
        _VERSIONS: {name: version(name) for name in ("jax", "jaxlib", "numpy", "pymunk")},
    }


@contextmanager
def claimed(folder: Path, manifest: dict[str, Any]) -> Iterator[None]:
    """Hold a folder for a study, alone.

    Raises:
        ConfigError: it belongs to another study (the message says what differs), or another
            process is at work in it.
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
            held = read_manifest(folder)
        except FileNotFoundError:
            held = None
        except ValueError:
            set_aside(folder / MANIFEST)
            held = None
        if held is None:
            _put(folder / MANIFEST, json.dumps(manifest, indent=1).encode())
        elif held["hash"] != manifest["hash"]:
            differs = ", ".join(_differences(held, manifest))
            raise ConfigError(
                f"{folder} holds another study, which differs in {differs}; give another --out"
            )
        yield


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of the study in a folder.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is torn, or not one.
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
    """A finished shard of variables; None if there is none, or it is torn or of another study."""
    path = _path(folder, k)
    try:
        with xr.open_dataset(path, engine="scipy") as dataset:
            dataset = dataset.load()
        return dataset[list(names)] if dataset.attrs["study"] == manifest["hash"] else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, IndexError):
        return None


def write_shard(folder: Path, k: int, manifest: dict[str, Any], dataset: xr.Dataset):
    """Put a finished shard in place; what stood there and could not be read is set aside."""
    path = _path(folder, k)
    if path.exists():
        set_aside(path)
    dataset = dataset.assign_attrs(study=manifest["hash"])
    _put(path, bytes(dataset.to_netcdf(engine="scipy")))


def set_aside(path: Path):
    """Keep a file that is in the way, under another name."""
    aside = path.with_suffix(f"{path.suffix}.bad")
    os.replace(path, aside)
    warnings.warn(f"{path} is torn or not of this study; kept as {aside.name}", stacklevel=2)


def _path(folder: Path, k: int) -> Path:
    return folder / SHARDS / f"{k:05d}.nc"


def _put(path: Path, content: bytes):
    part = path.with_suffix(f"{path.suffix}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def _differences(held: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """The keys, dotted, whose values differ."""
    found = []
    for key in sorted({*held, *wanted} - {"hash", _VERSIONS}):
        a, b = held.get(key), wanted.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            found += [f"{key}.{name}" for name in _differences(a, b)]
        elif a != b:
            found.append(key)
    return found
