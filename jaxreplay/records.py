"""Records Π: the demonstrations, kept as they were recorded (§ 2.1)."""

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

_FAR = 8  # times its spread: values this far from 0 lose three bits of their differences
_BROKEN_ZIP = (zipfile.BadZipFile, zlib.error)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["nodes", "commands", "lengths", "span"],
    meta_fields=["sensor_names", "command_names", "period", "offset"],
)
@dataclass(frozen=True, repr=False)
class Records:
    """N records of unequal lengths L_i, as arrays padded to L ≥ max_i L_i.

    Row t of a record is the command v_t and the observation ζ_t made *after* it, the order
    of § 2.3. An observation made before the first command has no row. (Minari and
    `imitation` store T + 1 observations for T actions: drop the first of them.)

    Build one with :meth:`from_sequences` or :meth:`load`.

    Attributes:
        nodes: `[n_s, N, L + 2]` observations ζ less the offset, sensor first, in the sensors'
            own units.
            Column j + 1 holds sample j. Columns 0 and L_i + 1 mirror the sample next to the
            end, so that the two segments at a record's end are the same one and equation 2
            needs no special case there. Later columns repeat the last sample.
        commands: `[n_u, N, L]` commands v, in the actuators' own units, zero past L_i.
        lengths: `[N]` the lengths L_i, int32.
        span: `[2, n_s]` the lowest and the highest of each sensor's nodes.
        sensor_names: n_s names.
        command_names: n_u names.
        period: time between rows in seconds, None when unknown.
        offset: n_s values, subtracted from observations in float64 before they are rounded to
            the working precision; not 0 only for a sensor whose values lie far from 0 for
            their spread, such as a position in UTM coordinates.
    """

    nodes: jax.Array
    commands: jax.Array
    lengths: jax.Array
    span: jax.Array
    sensor_names: tuple[str, ...]
    command_names: tuple[str, ...]
    period: float | None
    offset: tuple[float, ...]

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
        offset = _offset(np.concatenate(sensors))
        sensors = [s - offset for s in sensors]
        mirrored = [np.concatenate([s[:2][-1:], s, s[-2:][:1]]) for s in sensors]
        nodes = [_extend(m, longest + 2, "edge") for m in mirrored]
        rows = [_extend(c, longest, "constant") for c in commands]
        nodes = _cast(np.stack(nodes).transpose(2, 0, 1))
        return cls(
            nodes=jnp.asarray(nodes),
            commands=jnp.asarray(_cast(np.stack(rows).transpose(2, 0, 1))),
            lengths=jnp.asarray(lengths, dtype=jnp.int32),
            span=jnp.asarray([nodes.min((1, 2)), nodes.max((1, 2))]),
            sensor_names=_names(sensor_names, sensors[0].shape[1], "z", "sensor"),
            command_names=_names(command_names, commands[0].shape[1], "u", "command"),
            period=None if period is None else float(period),
            offset=tuple(map(float, offset)),
        )

    def __repr__(self) -> str:
        """What it holds, without the arrays."""
        return (
            f"Records of {self.n_records} demonstrations of up to {self.longest} samples; "
            f"sensors {', '.join(self.sensor_names)}; commands {', '.join(self.command_names)}"
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
        """L, the length that records are padded to."""
        return self.commands.shape[-1]

    def sequences(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """The records as :meth:`from_sequences` takes them: (L_i, n_s) and (L_i, n_u) arrays."""
        offset = np.array(self.offset)[:, None, None]
        nodes, commands = np.asarray(self.nodes, np.float64) + offset, np.asarray(self.commands)
        lengths = np.asarray(self.lengths)
        return (
            [nodes[:, i, 1 : n + 1].T.copy() for i, n in enumerate(lengths)],
            [commands[:, i, :n].T.copy() for i, n in enumerate(lengths)],
        )

    def centre(self, z: np.ndarray | jax.Array) -> np.ndarray | jax.Array:
        """Observations `[…, n_s]` less the offset, in the working precision.

        In float64 as long as z is not a JAX array: pass NumPy where the offset matters.

        Raises:
            ValueError: not n_s values.
        """
        if np.shape(z)[-1:] != (self.n_sensors,):
            raise self.misfit("z", np.shape(z))
        if isinstance(z, jax.Array):
            return z - jnp.asarray(self.offset, z.dtype) if any(self.offset) else z
        return _cast(np.asarray(z, dtype=np.float64) - np.array(self.offset))

    def misfit(self, name: str, shape: tuple[int, ...]) -> ValueError:
        """The error for what should hold a value for each sensor, and does not."""
        return ValueError(
            f"{name} has shape {shape}; the records have {self.n_sensors} sensors "
            f"({', '.join(self.sensor_names)}), so ({self.n_sensors},) is needed"
        )

    def subset(self, which: Sequence[int]) -> "Records":
        """The records with these indices (from 0), in this order.

        They stay padded to L, so that what was compiled for as many of them serves.

        Raises:
            ValueError: an index outside 0 … N − 1, or none.
        """
        which = list(which)
        if not which:
            raise ValueError("records need at least one demonstration; got none")
        if bad := [i for i in which if not 0 <= i < self.n_records]:
            raise ValueError(f"no record {bad[0]}: there are {self.n_records}, counted from 0")
        nodes = self.nodes[:, np.array(which)]
        return replace(
            self,
            nodes=nodes,
            commands=self.commands[:, np.array(which)],
            lengths=self.lengths[np.array(which)],
            span=jnp.stack([nodes.min((1, 2)), nodes.max((1, 2))]),
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
            with open(path, "rb") as stream:
                if not zipfile.is_zipfile(stream):
                    raise ValueError("it is not a whole .npz file")
                stream.seek(0)
                with np.load(stream, allow_pickle=False) as file:
                    held = {name: file[name] for name in file.files}
            cuts = np.cumsum(held["lengths"])[:-1]
            if np.min(held["lengths"]) < 1:
                raise ValueError("one of its lengths is less than 1")
            period = float(held["period"])
            for name in ("sensors", "commands"):
                if len(held[name]) != np.sum(held["lengths"]):
                    raise ValueError(f"its lengths add up to another number than its {name} rows")
            sequences = [np.split(held[name], cuts) for name in ("sensors", "commands")]
            names = [[str(n) for n in held[k]] for k in ("sensor_names", "command_names")]
        except FileNotFoundError:
            raise FileNotFoundError(f"no records file {path}") from None
        except (KeyError, ValueError, TypeError, OSError, EOFError, *_BROKEN_ZIP) as error:
            raise ValueError(
                f"{path} does not hold records (truncated, or written by something else): {error}"
            ) from error
        try:
            return cls.from_sequences(*sequences, *names, None if np.isnan(period) else period)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


def _as_rows(rows: np.ndarray, name: str, i: int) -> np.ndarray:
    """One sequence as an (L_i, n) array, finite in the working precision."""
    try:
        given = np.asarray(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"record {i}: {name} is not an array of numbers: {error}") from None
    if given.ndim != 2 or 0 in given.shape:
        raise ValueError(
            f"record {i}: {name} must have shape (time steps, dimensions), both at least 1; "
            f"got {given.shape}"
        )
    cast = _cast(given)
    if not np.isfinite(cast).all():
        t, k = np.argwhere(~np.isfinite(cast))[0]
        raise ValueError(
            f"record {i}: {name}[{t}, {k}] is {given[t, k]}, not a finite {cast.dtype}; "
            "cut or fill such rows before building records"
        )
    return given


def _cast(values: np.ndarray) -> np.ndarray:
    """In the working precision; what is too large becomes infinite."""
    with np.errstate(over="ignore"):
        return values.astype(jax.dtypes.canonicalize_dtype(np.float64))


def _offset(values: np.ndarray) -> np.ndarray:
    """The middle of each column whose values are all far from 0 for their spread, else 0.

    It is a float32, so that subtracting it from values that float32 holds rounds nothing.
    """
    low, high = values.min(axis=0), values.max(axis=0)
    middle = (low / 2 + high / 2).astype(np.float32).astype(np.float64)
    return np.where(np.maximum(np.abs(low), np.abs(high)) > _FAR * (high - low), middle, 0.0)


def _extend(rows: np.ndarray, length: int, mode: str) -> np.ndarray:
    return np.pad(rows, ((0, length - len(rows)), (0, 0)), mode=mode)


def _names(names: Sequence[str] | None, n: int, letter: str, what: str) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{letter}{k}" for k in range(n))
    names = tuple(str(name) for name in names)
    if len(names) != n or len(set(names)) != n:
        raise ValueError(f"{n} distinct {what} names are needed; got {list(names)}")
    return names
