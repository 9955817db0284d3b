"""A study's folder, read as one labelled dataset."""

import json
import warnings
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import NOMINAL, PlaneParams
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.dataset import SINCE, dtype_of, variables_of
from jaxreplay.study.factors import Factor
from jaxreplay.study.runs import runs_of, shards_of
from jaxreplay.study.store import ShardError, read_manifest, read_shard


def open_study(folder: str | Path) -> xr.Dataset:
    """Read the dataset of a study into memory, as far as the study is done.

    The filter stores each belief in a window of consecutive moments τ (positions on a record).

    Returns:
        Variables over the study's axes, `position` (on the plane) and `repeat`: `outcome`, whose
        attribute `meanings` explains its codes (S: success), `duration` (on the plane in s, of an
        environment in steps), `log_evidence` (NaN without a filter), `widened` (steps computed
        again in a wider window), `dropped` (log2 of the largest probability that a window
        discarded, bit), and, of one run in 56, `total_variation` and `command_error` (see
        :mod:`jaxreplay.loop.audit`). On the plane also `stall` (fixed, cyclic or slow, of an Fs),
        `lifted` (1 where the cube was lifted at any time, else 0; NaN in results of format 1) and
        `alignment_error` (mm, NaN unless S); of an environment `return` (sum of rewards) and
        `distance` (median over steps of the distance to the sample followed, σ). Axes that move
        together share the dimension of the first. Fixed factors are scalar coordinates. Missing
        runs have an empty outcome and NaN. The attribute `unverified` is the number of shards
        stored by an older version, without a checksum.

    Warns:
        UserWarning: a shard is damaged; its runs are missing.

    Raises:
        FileNotFoundError: there is no study in the folder.
        ValueError: its manifest is damaged, was edited, or is of a newer version.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    config = _config(manifest)
    world, runs = config.world, runs_of(config)
    variables = variables_of(world.outcomes, world.variables)
    results = {
        name: np.full(len(runs), "" if "values" in about else np.nan, dtype_of(about))
        for name, about in variables.items()
    }
    names = [n for n in variables if manifest.get("format", 0) >= SINCE.get(n, 0)]
    unverified = 0
    for k, which in enumerate(shards_of(config, runs, manifest["shard"])):
        try:
            shard = read_shard(folder, k, manifest, names, len(which))
        except ShardError as error:
            warnings.warn(f"{error}; left out: jaxreplay run does its runs again", stacklevel=2)
            continue
        if shard is not None:
            unverified += "checksum" not in shard.attrs
            for name in names:
                results[name][which] = shard[name].values.astype(results[name].dtype)
    sizes = {dim: len(config.axes[dim]) for dim in config.dims}
    sizes |= {"position": len(config.positions)} if config.positions else {}
    sizes["repeat"] = config.repeats
    return xr.Dataset(
        {
            name: (tuple(sizes), results[name].reshape(*sizes.values()), dict(about))
            for name, about in variables.items()
        },
        coords=_coordinates(config),
        attrs={"manifest": json.dumps(manifest), "unverified": unverified},
    )


def config_of(dataset: xr.Dataset) -> StudyConfig:
    """Return the config of the study that a dataset was read from."""
    return _config(json.loads(dataset.attrs["manifest"]))


def _config(manifest: dict[str, Any]) -> StudyConfig:
    stored = dict(manifest["config"])
    settings: dict[str, Any] = stored | {"demonstrations": stored["demonstrations"] or None}
    if "plane" in manifest:
        known = {f.name for f in fields(PlaneParams)} - set(SETTINGS)
        settings["plane"] = {n: v for n, v in manifest["plane"].items() if n in known}
    if manifest.get("format", 0) < 2:  # before robots differed from run to run
        old = {n: v for n, v in NOMINAL.items() if n not in stored["axes"]} | {"taught": "nominal"}
        settings["fixed"] = old | stored["fixed"]
    try:
        return StudyConfig(**settings)
    except (TypeError, ValueError) as error:  # such as a factor of a newer version
        raise ValueError(f"the study's config cannot be read: {error}") from None


def _coordinates(config: StudyConfig) -> dict[str, Any]:
    factors = config.world.factors
    coordinates: dict[str, Any] = {
        name: (dim, list(config.axes[name]), _about(factors[name]))
        for dim, group in config.dims.items()
        for name in group
    }
    coordinates |= {
        name: ((), value, _about(factors[name]))
        for name, value in config.fixed.items()
        if value is not None
    }
    return coordinates | config.world.coordinates() | {"repeat": np.arange(config.repeats)}


def _about(factor: Factor) -> dict[str, str]:
    about = {"symbol": factor.symbol, "long_name": factor.long_name}
    return about | ({"units": factor.units} if factor.units else {})
