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
from itertools import count
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
from jaxreplay.study.file import arguments_of
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
LAYOUT = 2  # of the files: since 2 every shard has a checksum. Of older folders this is absent.
MANIFEST, LOCK, SHARDS = "study.json", "study.lock", "shards"
# Entries that every manifest has, and their types.
_ENTRIES = {"config": dict, "demonstrations": str, "dtype": str, "shard": int, "hash": str}
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
        "demonstrations": content_of(demonstrations),
        "dtype": str(next(iter(demonstrations.values())).nodes.dtype),
        "shard": shard_size,
        "format": RESULTS_FORMAT,
        "layout": LAYOUT,
    }
    if config.environment is None:
        identity["plane"] = {n: v for n, v in plane.items() if n not in SETTINGS}
    identity = json.loads(json.dumps(identity))  # as it will be read again
    return identity | {
        "hash": hash_of(identity),
        _VERSIONS: {name: version(name) for name in _LIBRARIES},
    }


def content_of(demonstrations: Demonstrations) -> str:
    """Return a hash of all values of a study's records."""
    content = hashlib.sha256()
    for records in demonstrations.values():
        for array in (records.nodes, records.commands, records.lengths, records.offset):
            content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()


def check_format(folder: Path) -> None:
    """Check that this version can continue the study in a folder, if any, and repeat its runs.

    Raises:
        ConfigError: its results are of another `RESULTS_FORMAT`.
    """
    try:
        made = read_manifest(folder).get("format", 0)
    except NewerError as error:
        raise ConfigError(str(error)) from None
    except (FileNotFoundError, ValueError):
        return
    if made != RESULTS_FORMAT:
        raise ConfigError(
            f"{folder} contains a study of results format {made}; this version of jaxreplay makes "
            f"format {RESULTS_FORMAT} and cannot continue it or repeat its runs (show and plot "
            "still work): run the study in another folder, with --out"
        )


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Reserve a folder for this process; it is made if absent.

    Raises:
        ConfigError: another process is running in it.
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
        yield


def claim(folder: Path, manifest: dict[str, Any]) -> dict[str, Any]:
    """Reserve a locked folder for a study; return the manifest stored there.

    The manifest is written if there is none; one that is damaged is renamed first. One that was
    written before a factor or a constant existed is of the same study where this has its default,
    and so is one with the same demonstrations read from another path.

    Raises:
        ConfigError: it contains another study; the message lists the differences.
    """
    try:
        stored = read_manifest(folder)
    except FileNotFoundError:
        stored = None
    except ValueError as error:
        set_aside(folder / MANIFEST, str(error))
        stored = None
    if stored is None:
        write_whole(folder / MANIFEST, json.dumps(manifest, indent=1).encode())
    elif differs := _differences(_completed(stored, manifest), manifest):
        raise ConfigError(
            f"{folder} contains another study, which differs in {', '.join(differs)}; give "
            "another --out"
        )
    return stored or manifest


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of the study in a folder, once it is verified.

    Raises:
        FileNotFoundError: there is none.
        ValueError: the file is damaged, was edited, is no manifest, or is of a newer version.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise FileNotFoundError(
            f"no study in {folder}: {MANIFEST} is missing; jaxreplay run makes it"
        )
    try:
        manifest = json.loads(path.read_text("utf-8"))
        entries = [manifest[name] for name in _ENTRIES]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{path} is not the manifest of a study (truncated?)") from None
    if not all(map(isinstance, entries, _ENTRIES.values())) or manifest["hash"] != hash_of(
        manifest
    ):
        raise ValueError(
            f"{path} is damaged or was edited: it does not fit its hash; put it back as it was, or "
            "run the study in another folder"
        )
    if manifest.get("format", 0) > RESULTS_FORMAT:
        raise NewerError(
            f"{path} is of a newer version of jaxreplay (results format {manifest['format']}; this "
            f"one knows up to {RESULTS_FORMAT}); install that"
        )
    return manifest


def hash_of(manifest: dict[str, Any]) -> str:
    """Return the hash of a study's identity: of its manifest but for the hash and the versions."""
    identity = {name: v for name, v in manifest.items() if name not in ("hash", _VERSIONS)}
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


class NewerError(ValueError):
    """A study was made by a newer version of this package."""


class ShardError(ValueError):
    """A shard is damaged, or is another one than its name says."""


def read_shard(
    folder: Path, k: int, manifest: dict[str, Any], names: Iterable[str], n: int
) -> xr.Dataset | None:
    """Return the named variables of a shard, once it is verified; None if it is missing.

    Its attribute `checksum` is absent in a shard of an older version, which had none.

    Args:
        folder: of the study.
        k: index of the shard.
        manifest: of the study.
        names: of the variables.
        n: number of its runs.

    Raises:
        ShardError: it is damaged, or of another study, or of another place in this one.
    """
    path = _path(folder, k)
    try:
        with xr.open_dataset(path, engine="scipy") as dataset:
            dataset = dataset.load()
        given = dataset.attrs
        if given["study"] != manifest["hash"]:
            raise ShardError(f"{path} is of another study")
        old = "checksum" not in given and manifest.get("layout", 1) < LAYOUT
        expected = {"shard": k, "runs": n, "checksum": _checksum(dataset)}
        whole = old or all(given[name] == value for name, value in expected.items())
        if dataset.sizes != {"run": n} or not whole:
            raise ShardError(f"{path} is damaged, or another shard: it does not fit its checksum")
        return dataset[list(names)]
    except FileNotFoundError:
        return None
    except ShardError:
        raise
    except Exception as error:  # parsing damaged bytes can raise anything
        raise ShardError(f"{path} is damaged: {type(error).__name__}") from None


def write_shard(folder: Path, k: int, manifest: dict[str, Any], dataset: xr.Dataset) -> None:
    """Store a finished shard; an unreadable file in its place is renamed, not lost."""
    path = _path(folder, k)
    if path.exists():
        set_aside(path, f"{path} is damaged, or not of this study")
    attrs = {"study": manifest["hash"], "shard": k, "runs": dataset.sizes["run"]}
    dataset = dataset.assign_attrs(attrs, checksum=_checksum(dataset))
    write_whole(path, bytes(dataset.to_netcdf(engine="scipy")))


def set_aside(path: Path, why: str) -> None:
    """Rename a damaged file to `PATH.bad`, or `PATH.2.bad` and so on, and warn."""
    aside = path.with_name(f"{path.name}.bad")
    for number in count(2):
        if not aside.exists():
            break
        aside = path.with_name(f"{path.name}.{number}.bad")
    os.replace(path, aside)
    warnings.warn(f"{why}; kept as {aside.name}", stacklevel=2)


def _checksum(dataset: xr.Dataset) -> str:
    """Return a hash of the names and the values of all variables, whatever types they have."""
    content = hashlib.sha256()
    for name in sorted(map(str, dataset.data_vars)):
        values = dataset[name].values
        text = values.dtype.kind in "USO"
        content.update(name.encode() + b"\0")
        content.update(
            "\0".join(map(str, values)).encode() if text else values.astype("<f8").tobytes()
        )
    return content.hexdigest()


def _path(folder: Path, k: int) -> Path:
    return folder / SHARDS / f"{k:05d}.nc"


def _completed(stored: dict[str, Any], wanted: dict[str, Any]) -> dict[str, Any]:
    """Return a manifest with defaults for the factors and constants that it does not know.

    The path of the demonstrations is the wanted one: their content has a hash of its own.
    """
    config, plane = stored["config"], asdict(PlaneParams())
    path = wanted["config"]["demonstrations"]
    if arguments_of(path) == arguments_of(config["demonstrations"]):
        config = config | {"demonstrations": path}
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
    for key in sorted({*stored, *wanted} - {"hash", "layout", _VERSIONS}):
        a, b = stored.get(key), wanted.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            found += [f"{key}.{name}" for name in _differences(a, b)]
        elif a != b:
            found.append(key)
    return found
