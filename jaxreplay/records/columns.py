"""Checked sequences as the padded arrays of :class:`Records`, a column for each sample."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxreplay.records.arrays import cast, extend, offset_of
from jaxreplay.records.long import longest_first
from jaxreplay.records.missing import filled


def command_range(commands: jax.Array, lengths: jax.Array) -> np.ndarray:
    """Return the lowest and the highest of each command, `[2, n_u]`, without the padding.

    Args:
        commands: `[n_u, N, L]`, as in :class:`Records`.
        lengths: `[N]`.
    """
    inside = np.arange(commands.shape[-1]) < np.asarray(lengths)[:, None]
    recorded = np.asarray(commands)[:, inside]
    return np.stack([recorded.min(axis=1), recorded.max(axis=1)])


def columns_of(
    sensors: list[np.ndarray], commands: list[np.ndarray], sensor_names: tuple[str, ...]
) -> dict[str, Any]:
    """Return the fields of :class:`Records` that follow from the rows, by name.

    Args:
        sensors: N arrays `[L_i, n_s]`, NaN where not measured.
        commands: N arrays `[L_i, n_u]`.
        sensor_names: `[n_s]`.

    Raises:
        ValueError: a sensor was not measured in a whole record.
    """
    lengths = [len(s) for s in sensors]
    longest = max(lengths)
    missing = [extend(np.isnan(s), longest, "constant") for s in sensors]
    sensors = [filled(s, i, sensor_names) for i, s in enumerate(sensors)]
    offset = offset_of(np.concatenate(sensors))
    sensors = [s - offset for s in sensors]
    mirrored = [np.concatenate([s[:2][-1:], s, s[-2:][:1]]) for s in sensors]
    nodes = [extend(m, longest + 2, "edge") for m in mirrored]
    rows = [extend(c, longest, "constant") for c in commands]
    nodes = cast(np.stack(nodes).transpose(2, 0, 1))
    span = np.stack([nodes.min((1, 2)), nodes.max((1, 2))])
    unmeasured = np.stack(missing).transpose(2, 0, 1)
    return {
        "nodes": jnp.asarray(nodes),
        "commands": jnp.asarray(cast(np.stack(rows).transpose(2, 0, 1))),
        "lengths": jnp.asarray(lengths, dtype=jnp.int32),
        "span": jnp.asarray(span),
        "long": longest_first(nodes, np.array(lengths)),
        "offset": tuple(map(float, offset)),
        "unmeasured": jnp.asarray(unmeasured) if unmeasured.any() else None,
    }
