"""Records Π: the demonstrations, stored sample by sample (§ 2.1)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxreplay.machine import write_whole
from jaxreplay.records.arrays import both, cast, check_period, names, one_row_later
from jaxreplay.records.columns import columns_of
from jaxreplay.records.file import stored
from jaxreplay.records.given import one_for_each
from jaxreplay.records.long import LongestFirst, longest_first
from jaxreplay.records.resample import resample


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["nodes", "commands", "lengths", "span", "long", "unmeasured"],
    meta_fields=["sensor_names", "command_names", "period", "offset"],
)
@dataclass(frozen=True, repr=False)
class Records:
    """N records of unequal lengths L_i, as arrays padded to a common length L ≥ max_i L_i.

    Row t of a record is the command v_t and the observation ζ_t made *after* it (§ 2.3).
    Build records with :meth:`from_sequences`, :meth:`from_steps`, :meth:`load` or `jr.read`.

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
        unmeasured: `[n_s, N, L]` bool, samples that were NaN: straight lines between the measured
            ones take their place in `nodes` (see :mod:`jaxreplay.records.missing`). None if all
            were measured.
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
    unmeasured: jax.Array | None = None

    @classmethod
    def from_sequences(
        cls,
        sensors: Iterable[Any],
        commands: Iterable[Any],
        sensor_names: Sequence[str] | None = None,
        command_names: Sequence[str] | None = None,
        period: float | None = None,
    ) -> "Records":
        """Return the records of N demonstrations.

        Bools count as 0 and 1, masked values as NaN. Data frames (pandas, polars) are taken by the
        names of their columns, which must be the same in all, in whatever order.

        Args:
            sensors: N arrays or data frames, the i-th `[L_i, n_s]` with L_i ≥ 1; or `[N, L, n_s]`.
                NaN marks a sample that was not measured.
            commands: N arrays or data frames, the i-th `[L_i, n_u]`; or `[N, L, n_u]`.
            sensor_names: `[n_s]` distinct names; by default those of data frames, or z0, z1, …
            command_names: `[n_u]` distinct names; by default those of data frames, or u0, u1, …
            period: time between rows in s, if known.

        Raises:
            ValueError: there is no record, a record is empty, shapes or names do not match, a
                value is no number or infinite in the working precision, a command or a whole
                sensor is NaN, or the period is not positive.
        """
        sensors, sensor_names = one_for_each(sensors, "sensors", sensor_names)
        commands, command_names = one_for_each(commands, "commands", command_names)
        sensors, commands = both(sensors, commands)
        check_period(period)
        sensor_names = names(sensor_names, sensors[0].shape[1], "z", "sensor")
        return cls(
            **columns_of(sensors, commands, sensor_names),
            sensor_names=sensor_names,
            command_names=names(command_names, commands[0].shape[1], "u", "command"),
            period=None if period is None else float(period),
        )

    @classmethod
    def from_steps(
        cls,
        observations: Iterable[Any],
        actions: Iterable[Any],
        sensor_names: Sequence[str] | None = None,
        command_names: Sequence[str] | None = None,
        period: float | None = None,
    ) -> "Records":
        """Return the records of N episodes in which observation o_t stands before action a_t.

        Row t of a record is a_t and o_(t+1), so an episode's first observation is lost. With as
        many observations as actions (LeRobot, robomimic) its last action is lost too, as no
        observation follows it; with T + 1 observations for T actions (Minari, imitation) it is not.

        Args:
            observations: N arrays or data frames, `[T_i + 1, n_s]` or `[T_i, n_s]`.
            actions: N arrays or data frames, `[T_i, n_u]`.
            sensor_names: see :meth:`from_sequences`.
            command_names: see :meth:`from_sequences`.
            period: time between rows in s, if known.

        Raises:
            ValueError: the numbers of observations and actions differ otherwise, an episode has
                fewer than 2 observations, or see :meth:`from_sequences`.
        """
        observations, sensor_names = one_for_each(observations, "observations", sensor_names)
        actions, command_names = one_for_each(actions, "actions", command_names)
        return cls.from_sequences(
            *one_row_later(observations, actions), sensor_names, command_names, period
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

    def sequences(self, filled: bool = False) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the records as lists of arrays `[L_i, n_s]` and `[L_i, n_u]`.

        They are rounded to the working precision.

        Args:
            filled: whether straight lines take the place of samples not measured, instead of NaN.
        """
        offset = np.array(self.offset)[:, None, None]
        nodes, commands = np.asarray(self.nodes, np.float64) + offset, np.asarray(self.commands)
        sensors = nodes[:, :, 1:-1]
        if self.unmeasured is not None and not filled:
            sensors = np.where(self.unmeasured, np.nan, sensors)
        lengths = np.asarray(self.lengths)
        return (
            [sensors[:, i, :n].T.copy() for i, n in enumerate(lengths)],
            [commands[:, i, :n].T.copy() for i, n in enumerate(lengths)],
        )

    def centred(self) -> "Records":
        """Return the nodes and commands unchanged, for centred observations.

        The offset is 0; names, period and which samples were measured are left out, so that
        programs compiled for records of one shape serve all of them.
        """
        offset = (0.0,) * self.n_sensors
        return replace(
            self, sensor_names=(), command_names=(), period=None, offset=offset, unmeasured=None
        )

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

    def check_finite(self, name: str, centred: np.ndarray | jax.Array) -> None:
        """Check that no centred observation `[…, n_s]` is infinite; those traced by JAX pass.

        Raises:
            ValueError: one is, in the working precision.
        """
        if isinstance(centred, Tracer):
            return
        infinite = np.isinf(np.asarray(centred))
        if infinite.any():
            *_, k = place = np.argwhere(infinite)[0].tolist()
            sensor = f" ({self.sensor_names[k]})" if self.sensor_names else ""
            raise ValueError(
                f"{name}[{', '.join(map(str, place))}]{sensor} is infinite in {self.nodes.dtype}; "
                "give NaN for what was not measured"
            )

    def misfit(self, name: str, shape: tuple[int, ...]) -> ValueError:
        """Return the error for an argument of this shape that should have a value per sensor."""
        names = f" ({', '.join(self.sensor_names)})" if self.sensor_names else ""
        return ValueError(
            f"{name} has shape {shape}; the records have {self.n_sensors} sensors{names}, so "
            f"({self.n_sensors},) is needed"
        )

    def resampled(self, period: float) -> "Records":
        """Return the records at another rate, see :mod:`jaxreplay.records.resample`.

        Args:
            period: s between rows; the records themselves are returned where it is theirs.

        Raises:
            ValueError: it is not a positive number, or the records' period is unknown.
        """
        check_period(period)
        if self.period is None:
            raise ValueError(
                f"records of unknown period cannot be resampled to {period} s: give their own "
                "period when they are made, period=…"
            )
        if np.isclose(period, self.period, rtol=1e-6):
            return self
        each = zip(*self.sequences(), strict=True)
        pairs = [resample(s, c, period / self.period) for s, c in each]
        return Records.from_sequences(
            [s for s, _ in pairs], [c for _, c in pairs], self.sensor_names, self.command_names,
            period,
        )  # fmt: skip

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
            unmeasured=None if self.unmeasured is None else self.unmeasured[:, np.array(which)],
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
        contents = stored(path)
        try:
            return cls.from_sequences(*contents)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
