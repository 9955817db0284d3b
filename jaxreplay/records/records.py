"""Records Π: the demonstrations, stored sample by sample (§ 2.1)."""

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from numbers import Real
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.machine import write_whole
from jaxreplay.records.arrays import as_rows, cast, extend, names, offset_of
from jaxreplay.records.long import LongestFirst, longest_first

_BROKEN = (KeyError, ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile, zlib.error)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["nodes", "commands", "lengths", "span", "long"],
    meta_fields=["sensor_names", "command_names", "period", "offset"],
)
@dataclass(frozen=True, repr=False)
class Records:
    """N records of unequal lengths L_i, as arrays padded to a common length L ≥ max_i L_i.

    Row t of a record is the command v_t and the observation ζ_t made *after* it, the order of
    § 2.3. An observation made before the first command has no row. (Minari and `imitation`
    store T + 1 observations for T actions: drop the first of them.)

    Build records with :meth:`from_sequences` or :meth:`load`.

    Attributes:
        nodes: `[n_s, N, L + 2]` observations ζ less the offset, in the sensors' own units.
            Column j + 1 is sample j (samples counted from 0). Columns 0 and L_i + 1 mirror the
            samples next to the first and the last one, so that the two segments at a record's end
            coincide and equation 2 needs no special case there. Later columns repeat L_i + 1.
        commands: `[n_u, N, L]` commands v, in the actuators' own units, 0 past L_i.
        lengths: `[N]` the lengths L_i in samples, int32.
        span: `[2, n_s]` the lowest and the highest of each sensor's nodes, in its own unit.
        long: the list of the longest segments (see :mod:`jaxreplay.records.long`).
        sensor_names: `[n_s]` distinct names.
        command_names: `[n_u]` distinct names.
        period: time between rows in s; None if unknown.
        offset: `[n_s]` in the sensors' own units, subtracted from observations in float64 before
            they are rounded to the working precision. It is 0 except for a sensor whose values
            are far from 0 compared with their spread, such as a position in UTM coordinates.
    """

    nodes: jax.Array
    commands: jax.Array
    lengths: jax.Array
    span: jax.Array
    long: LongestFirst
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
        """Return the records of N demonstrations.

        Args:
            sensors: N arrays, the i-th `[L_i, n_s]` with L_i ≥ 1.
            commands: N arrays, the i-th `[L_i, n_u]`.
            sensor_names: `[n_s]` distinct names; by default z0, z1, …
            command_names: `[n_u]` distinct names; by default u0, u1, …
            period: time between rows in s, if known.

        Raises:
            ValueError: there is no record, a record is empty, shapes or names do not match, a
                value is not finite in the working precision, or the period is not positive.
        """
        sensors = [as_rows(s, "sensors", i) for i, s in enumerate(sensors)]
        commands = [as_rows(c, "commands", i) for i, c in enumerate(commands)]
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
                        f"{first.shape[1]}; all records must have the same {name}"
                    )
        if period is not None and not (isinstance(period, Real) and 0 < period < np.inf):
            raise ValueError(f"period must be a positive number of seconds; got {period!r}")

        lengths = [len(s) for s in sensors]
        longest = max(lengths)
        offset = offset_of(np.concatenate(sensors))
        sensors = [s - offset for s in sensors]
        mirrored = [np.concatenate([s[:2][-1:], s, s[-2:][:1]]) for s in sensors]
        nodes = [extend(m, longest + 2, "edge") for m in mirrored]
        rows = [extend(c, longest, "constant") for c in commands]
        nodes = cast(np.stack(nodes).transpose(2, 0, 1))
        span = np.stack([nodes.min((1, 2)), nodes.max((1, 2))])
        return cls(
            nodes=jnp.asarray(nodes),
            commands=jnp.asarray(cast(np.stack(rows).transpose(2, 0, 1))),
            lengths=jnp.asarray(lengths, dtype=jnp.int32),
            span=jnp.asarray(span),
            long=longest_first(nodes, np.array(lengths)),
            sensor_names=names(sensor_names, sensors[0].shape[1], "z", "sensor"),
            command_names=names(command_names, commands[0].shape[1], "u", "command"),
            period=None if period is None else float(period),
            offset=tuple(map(float, offset)),
        )

    def __repr__(self) -> str:
        """Return sizes and names in one line, without the arrays."""
        return (
            f"Records of {self.n_records} demonstrations of up to {self.longest} samples; "
            f"sensors {', '.join(self.sensor_names)}; commands {', '.join(self.command_names)}"
        )

    @property
    def n_records(self) -> int:
        """N, the number of records."""
        return self.nodes.shape[-2]

    @property
    def n_sensors(self) -> int:
        """n_s, the number of sensors."""
        return self.nodes.shape[-3]

    @property
    def n_commands(self) -> int:
        """n_u, the number of values in a command."""
        return self.commands.shape[-3]

    @property
    def longest(self) -> int:
        """L, the length in samples to which records are padded."""
        return self.commands.shape[-1]

    def sequences(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the records as lists of arrays `[L_i, n_s]` and `[L_i, n_u]`.

        They are rounded to the working precision.
        """
        offset = np.array(self.offset)[:, None, None]
        nodes, commands = np.asarray(self.nodes, np.float64) + offset, np.asarray(self.commands)
        lengths = np.asarray(self.lengths)
        return (
            [nodes[:, i, 1 : n + 1].T.copy() for i, n in enumerate(lengths)],
            [commands[:, i, :n].T.copy() for i, n in enumerate(lengths)],
        )

    def centred(self) -> "Records":
        """Return the nodes and commands unchanged, for centred observations.

        The offset is 0, and names and period are left out, so that programs compiled for records
        of one shape serve all of them.
        """
        offset = (0.0,) * self.n_sensors
        return replace(self, sensor_names=(), command_names=(), period=None, offset=offset)

    def centre(self, z: np.ndarray | jax.Array) -> np.ndarray | jax.Array:
        """Return observations less the offset, as the nodes are stored.

        NumPy arrays: computed in float64, returned in the working precision. JAX arrays: computed
        and returned in their own precision, so pass NumPy arrays where an offset is not 0.

        Args:
            z: `[…, n_s]` observations, in the sensors' own units.

        Raises:
            ValueError: the last axis of z does not have n_s values.
        """
        if np.shape(z)[-1:] != (self.n_sensors,):
            raise self.misfit("z", np.shape(z))
        if isinstance(z, jax.Array):
            offset = jnp.broadcast_to(jnp.asarray(self.offset, z.dtype), z.shape)
            return z - offset if any(self.offset) else z
        return cast(np.asarray(z, dtype=np.float64) - np.array(self.offset))

    def check_one_each(self, **values: np.ndarray | jax.Array) -> None:
        """Check that named values have one number for each sensor.

        Raises:
            ValueError: a value does not have the shape `[n_s]`.
        """
        for name, value in values.items():
            if np.shape(value) != (self.n_sensors,):
                raise self.misfit(name, np.shape(value))

    def misfit(self, name: str, shape: tuple[int, ...]) -> ValueError:
        """Return the error for an argument of this shape that should have a value per sensor."""
        names = f" ({', '.join(self.sensor_names)})" if self.sensor_names else ""
        return ValueError(
            f"{name} has shape {shape}; the records have {self.n_sensors} sensors{names}, so "
            f"({self.n_sensors},) is needed"
        )

    def subset(self, which: Sequence[int]) -> "Records":
        """Return the records with the given indices (from 0), in the given order.

        They stay padded to L, so that programs compiled for the same number of records are reused.

        Raises:
            ValueError: no index is given, or one is outside 0 … N − 1.
        """
        which = list(which)
        if not which:
            raise ValueError("records need at least one demonstration; got none")
        if bad := [i for i in which if not 0 <= i < self.n_records]:
            raise ValueError(f"no record {bad[0]}: there are {self.n_records}, counted from 0")
        nodes = np.asarray(self.nodes)[:, which]
        lengths = np.asarray(self.lengths)[which]
        span = np.stack([nodes.min((1, 2)), nodes.max((1, 2))])
        return replace(
            self,
            nodes=jnp.asarray(nodes),
            commands=self.commands[:, np.array(which)],
            lengths=jnp.asarray(lengths),
            span=jnp.asarray(span),
            long=longest_first(nodes, lengths),
        )

    def save(self, path: str | Path) -> None:
        """Write the records to one `.npz` file without pickled objects, completely or not at all.

        Raises:
            OSError: the file cannot be written; an older one is unchanged.
        """
        sensors, commands = self.sequences()
        content = BytesIO()
        np.savez_compressed(
            content,
            sensors=np.concatenate(sensors),
            commands=np.concatenate(commands),
            lengths=np.asarray(self.lengths),
            sensor_names=np.array(self.sensor_names),
            command_names=np.array(self.command_names),
            period=np.array(np.nan if self.period is None else self.period),
        )
        write_whole(path, content.getvalue())

    @classmethod
    def load(cls, path: str | Path) -> "Records":
        """Return the records in a file that :meth:`save` wrote.

        Raises:
            OSError: there is no such file, or it cannot be opened.
            ValueError: the file is truncated, or does not contain records.
        """
        try:
            with open(path, "rb") as stream:
                if not zipfile.is_zipfile(stream):
                    raise ValueError("it is not a whole .npz file")
                stream.seek(0)
                with np.load(stream, allow_pickle=False) as file:
                    parts = {name: file[name] for name in file.files}
            lengths = parts["lengths"]
            cuts = np.cumsum(lengths)[:-1]
            if np.min(lengths) < 1:
                raise ValueError("one of its lengths is less than 1")
            period = None if np.isnan(float(parts["period"])) else float(parts["period"])
            for name in ("sensors", "commands"):
                if len(parts[name]) != np.sum(lengths):
                    raise ValueError(f"its lengths do not add up to its number of {name} rows")
            sensors, commands = (np.split(parts[k], cuts) for k in ("sensors", "commands"))
            sensor_names = [str(name) for name in parts["sensor_names"]]
            command_names = [str(name) for name in parts["command_names"]]
        except FileNotFoundError:
            raise FileNotFoundError(f"no records file {path}") from None
        except (PermissionError, IsADirectoryError):
            raise
        except _BROKEN as error:
            cause = "(truncated, or written by something else)"
            raise ValueError(f"{path} does not contain records {cause}: {error}") from error
        try:
            return cls.from_sequences(sensors, commands, sensor_names, command_names, period)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
