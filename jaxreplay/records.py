"""Records Π: the demonstrations, kept as they were recorded (§ 2.1)."""

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from numbers import Real
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

_BROKEN_ZIP = (zipfile.BadZipFile, zlib.error)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["nodes", "commands", "lengths"],
    meta_fields=["sensor_names", "command_names", "period"],
)
@dataclass(frozen=True)
class Records:
    """N records of unequal lengths L_i, as arrays padded to L = max_i L_i.

    Row t of a record is the command v_t and the observation ζ_t made *after* it, the order
    of § 2.3. An observation made before the first command has no row. (Minari and
    `imitation` store T + 1 observations for T actions: drop the first of them.)

    Build one with :meth:`from_sequences` or :meth:`load`.

    Attributes:
        nodes: `[n_s, N, L + 2]` observations ζ, sensor first, in the sensors' own units.
            Column j + 1 holds sample j. Columns 0 and L_i + 1 mirror the sample next to the
            end, so that the two segments at a record's end are the same one and equation 2
            needs no special case there. Later columns repeat the last sample.
        commands: `[n_u, N, L]` commands v, in the actuators' own units, zero past L_i.
        lengths: `[N]` the lengths L_i, int32.
        sensor_names: n_s names.
        command_names: n_u names.
        period: time between rows in seconds, None when unknown.
    """

    nodes: jax.Array
    commands: jax.Array
    lengths: jax.Array
    sensor_names: tuple[str, ...]
    command_names: tuple[str, ...]
    period: float | None = None

    @classmethod
    def from_sequences(
        cls,
        sensors: Sequence[np.ndarray],
        commands: Sequence[np.ndarray],
        sensor_names: Sequence[str] | None = None,
        command_names: Sequence[str] | None = None,
        period: float | None = None,
    ) -> "Records":
        """Pack recorded demonstrations.

        Args:
            sensors: N arrays, the i-th of shape (L_i, n_s), L_i ≥ 1.
            commands: N arrays, the i-th of shape (L_i, n_u).
            sensor_names: n_s distinct names; z0, z1, … when not given.
            command_names: n_u distinct names; u0, u1, … when not given.
            period: time between rows in seconds.

        Raises:
            ValueError: no record, an empty record, shapes that do not fit, a value that is
                not finite in the working precision, names that do not fit, period ≤ 0.
        """
        sensors = [_as_rows(s, "sensors", i) for i, s in enumerate(sensors)]
        commands = [_as_rows(c, "commands", i) for i, c in enumerate(commands)]
        if not sensors:
            raise ValueError("records need at least one demonstration; got none")
        if len(sensors) != len(commands):
            raise ValueError(
                f"{len(sensors)} sensor sequences but {len(commands)} command sequences; "
                "give one of each for every demonstration"
            )
        for i, (s, c) in enumerate(zip(sensors, commands, strict=True)):
            if len(s) != len(c):
                raise ValueError(
                    f"record {i}: {len(s)} sensor rows but {len(c)} command rows; row t is a "
                    "command and the observation made after it (drop the observation that "
                    "came before the first command)"
                )
            for name, rows, first in (("sensors", s, sensors[0]), ("commands", c, commands[0])):
                if rows.shape[1] != first.shape[1]:
                    raise ValueError(
                        f"record {i}: {name} has {rows.shape[1]} columns, record 0 has "
                        f"{first.shape[1]}; all records must hold the same {name}"
                    )
        if period is not None and not (isinstance(period, Real) and 0 < period < np.inf):
            raise ValueError(f"period must be a positive number of seconds, not {period!r}")

        lengths = [len(s) for s in sensors]
        longest = max(lengths)
        mirrored = [np.concatenate([s[:2][-1:], s, s[-2:][:1]]) for s in sensors]
        nodes = [_extend(m, longest + 2, "edge") for m in mirrored]
        rows = [_extend(c, longest, "constant") for c in commands]
        return cls(
            nodes=jnp.asarray(np.stack(nodes).transpose(2, 0, 1)),
            commands=jnp.asarray(np.stack(rows).transpose(2, 0, 1)),
            lengths=jnp.asarray(lengths, dtype=jnp.int32),
            sensor_names=_names(sensor_names, sensors[0].shape[1], "z", "sensor"),
            command_names=_names(command_names, commands[0].shape[1], "u", "command"),
            period=None if period is None else float(period),
        )

    @property
    def n_records(self) -> int:
        """N."""
        return self.nodes.shape[-2]

    @property
    def n_sensors(self) -> int:
        """n_s."""
        return self.nodes.shape[-3]

    @property
    def n_commands(self) -> int:
        """n_u."""
        return self.commands.shape[-3]

    @property
    def longest(self) -> int:
        """L = max_i L_i."""
        return self.commands.shape[-1]

    def sequences(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The records as :meth:`from_sequences` takes them: (L_i, n_s) and (L_i, n_u) arrays."""
        nodes, commands = np.asarray(self.nodes), np.asarray(self.commands)
        lengths = np.asarray(self.lengths)
        return (
            [nodes[:, i, 1 : n + 1].T.copy() for i, n in enumerate(lengths)],
            [commands[:, i, :n].T.copy() for i, n in enumerate(lengths)],
        )

    def subset(self, which: Sequence[int]) -> "Records":
        """The records with these indices (from 0), in this order.

        Raises:
            ValueError: an index outside 0 … N − 1, or none.
        """
        if bad := [i for i in which if not 0 <= i < self.n_records]:
            raise ValueError(f"no record {bad[0]}: there are {self.n_records}, counted from 0")
        sensors, commands = self.sequences()
        return Records.from_sequences(
            [sensors[i] for i in which],
            [commands[i] for i in which],
            self.sensor_names,
            self.command_names,
            self.period,
        )

    def save(self, path: str | Path) -> None:
        """Write one `.npz` file (no pickling), whole or not at all."""
        path = Path(path)
        sensors, commands = self.sequences()
        part = path.with_name(path.name + ".part")
        with part.open("wb") as file:
            np.savez_compressed(
                file,
                sensors=np.concatenate(sensors),
                commands=np.concatenate(commands),
                lengths=np.asarray(self.lengths),
                sensor_names=np.array(self.sensor_names),
                command_names=np.array(self.command_names),
                period=np.array(np.nan if self.period is None else self.period),
            )
        part.replace(path)

    @classmethod
    def load(cls, path: str | Path) -> "Records":
        """Read what :meth:`save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is truncated, or not one of records.
        """
        try:
            with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
                held = {name: file[name] for name in file.files}
            cuts = np.cumsum(held["lengths"])[:-1]
            period = float(held["period"])
            for name in ("sensors", "commands"):
                if len(held[name]) != np.sum(held["lengths"]):
                    raise ValueError(f"its lengths add up to another number than its {name} rows")
            return cls.from_sequences(
                np.split(held["sensors"], cuts),
                np.split(held["commands"], cuts),
                [str(name) for name in held["sensor_names"]],
                [str(name) for name in held["command_names"]],
                None if np.isnan(period) else period,
            )
        except FileNotFoundError:
            raise FileNotFoundError(f"no records file {path}") from None
        except (KeyError, ValueError, TypeError, OSError, EOFError, *_BROKEN_ZIP) as error:
            raise ValueError(
                f"{path} does not hold records (truncated, or written by something else): {error}"
            ) from error


def _as_rows(rows: np.ndarray, name: str, i: int) -> np.ndarray:
    """One sequence as a finite (L_i, n) array in the working precision."""
    try:
        given = np.asarray(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"record {i}: {name} is not an array of numbers: {error}") from None
    if given.ndim != 2 or 0 in given.shape:
        raise ValueError(
            f"record {i}: {name} must have shape (time steps, dimensions), both at least 1; "
            f"got {given.shape}"
        )
    with np.errstate(over="ignore"):
        cast = given.astype(jax.dtypes.canonicalize_dtype(np.float64))
    if not np.isfinite(cast).all():
        t, k = np.argwhere(~np.isfinite(cast))[0]
        raise ValueError(
            f"record {i}: {name}[{t}, {k}] is {given[t, k]}, not a finite {cast.dtype}; "
            "cut or fill such rows before building records"
        )
    return cast


def _extend(rows: np.ndarray, length: int, mode: str) -> np.ndarray:
    return np.pad(rows, ((0, length - len(rows)), (0, 0)), mode=mode)


def _names(names: Sequence[str] | None, n: int, letter: str, what: str) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{letter}{k}" for k in range(n))
    names = tuple(str(name) for name in names)
    if len(names) != n or len(set(names)) != n:
        raise ValueError(f"{n} distinct {what} names are needed; got {list(names)}")
    return names
