"""The machine this runs on: its cores, its disk, and JAX's cache of compiled programs."""

import os
import secrets
import tomllib
import warnings
from pathlib import Path
from typing import Any

from jaxreplay.errors import ConfigError

LARGEST_TOML = 2**24  # bytes


def keep_compiled() -> None:
    """Store compiled programs in the user's cache, unless JAX is configured otherwise.

    The folder is `$XDG_CACHE_HOME/jaxreplay`, or `~/.cache/jaxreplay`. Where it cannot be made,
    programs are compiled anew in each process.
    """
    import jax

    if jax.config.jax_compilation_cache_dir is not None:  # pyright: ignore[reportAttributeAccessIssue]
        return
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxreplay"
        cache.mkdir(parents=True, exist_ok=True)
        if not os.access(cache, os.W_OK | os.X_OK):
            raise PermissionError
    except (OSError, RuntimeError):  # RuntimeError: the user has no home folder
        warnings.warn(
            "compiled programs cannot be stored (is XDG_CACHE_HOME, or ~/.cache, writable?): each "
            "start compiles anew",
            stacklevel=2,
        )
        return
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # JAX stores only programs that took over 1 s to compile; ours take 0.1–2 s each.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def read_toml(path: Path) -> dict[str, Any]:
    """Return the contents of a TOML file.

    Raises:
        ConfigError: the file cannot be read, or is not TOML.
    """
    try:
        if path.stat().st_size > LARGEST_TOML:
            raise ConfigError(
                f"{path}: is larger than {LARGEST_TOML >> 20} MiB: not a study's file"
            )
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))  # with or without a mark
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ConfigError:
        raise
    except ValueError as error:  # not TOML, or not UTF-8
        raise ConfigError(f"{path}: is not TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{path}: is not TOML: too deeply nested") from None


def write_whole(path: str | Path, content: bytes) -> None:
    """Write a file completely or not at all: a reader never finds part of it.

    The content goes to a file of its own ending in `.part`, which then takes the place of `PATH`.

    Raises:
        OSError: the file cannot be written; what stood at `PATH` before is unchanged.
    """
    path = Path(path)
    part = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        error.filename = str(path)  # a full disk does not name the file
        raise
