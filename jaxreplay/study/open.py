"""A study's folder, read as one labelled dataset."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxreplay.plane.options import SETTINGS
from jaxreplay.plane.params import NOMINAL, PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.study.config import StudyConfig
from jaxreplay.study.dataset import SINCE, TEXT, VARIABLES
from jaxreplay.study.factors import FACTORS
from jaxreplay.study.runs import runs_of, shards_of
from jaxreplay.study.store import read_manifest, read_shard


def open_study(folder: str | Path) -> xr.Dataset:
    """Read the dataset of a study into memory, as far as the study is done.

    The filter stores each belief in a window of consecutive moments τ (positions on a record).

    Returns:
        Variables `outcome` (S, Fs, Fg or Fb), `stall` (fixed, cyclic or slow, of an Fs), `lifted`
        (1 where the cube was lifted at any time, else 0; NaN in results of format 1),
        `alignment_error` (mm, NaN unless S), `duration` (s), `log_evidence` (NaN without a filter),
        `widened` (steps computed again in a wider window), `dropped` (log2 of the largest
        probability that a window discarded, bit), and, of one run in 56, `total_variation` and
        `command_error` (see :mod:`jaxreplay.loop.audit`), over the study's axes, `position` and
        `repeat`. Axes that move together share the dimension of the first. Fixed factors are
        scalar coordinates. Missing runs have an empty outcome and NaN.

    Raises:
        FileNotFoundError: there is no study in the folder.
        ValueError: its manifest is truncated, or not one of a study.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    config = _config(manifest)
    runs = runs_of(config)
    results = {
        name: np.full(len(runs), "" if name in TEXT else np.nan, TEXT.get(name, float))
        for name in VARIABLES
    }
    names = [n for n in VARIABLES if manifest.get("format", 0) >= SINCE.get(n, 0)]
    for k, which in enumerate(shards_of(config, runs, manifest["shard"])):
        shard = read_shard(folder, k, manifest, names)
        if shard is not None:
            for name in names:
                results[name][which] = shard[name].values.astype(results[name].dtype)
    dims = (*config.dims, "position", "repeat")
    shape = (*(len(config.axes[dim]) for dim in config.dims), len(config.positions), config.repeats)
    return xr.Dataset(
        {name: (dims, results[name].reshape(shape), about) for name, about in VARIABLES.items()},
        coords=_coordinates(config),
        attrs={"manifest": json.dumps(manifest)},
    )


def config_of(dataset: xr.Dataset) -> StudyConfig:
    """Return the config of the study that a dataset was read from."""
    return _config(json.loads(dataset.attrs["manifest"]))


def _config(manifest: dict[str, Any]) -> StudyConfig:
    stored = dict(manifest["config"])
    known = {f.name for f in fields(PlaneParams)} - set(SETTINGS)
    plane = {name: value for name, value in manifest["plane"].items() if name in known}
    if manifest.get("format", 0) < 2:  # before robots differed from run to run
        old = {n: v for n, v in NOMINAL.items() if n not in stored["axes"]} | {"taught": "nominal"}
        stored["fixed"] = old | stored["fixed"]
    return StudyConfig(
        **stored | {"demonstrations": stored["demonstrations"] or None, "plane": plane}
    )


def _coordinates(config: StudyConfig) -> dict[str, Any]:
    cubes = np.array(config.positions)
    coordinates: dict[str, Any] = {
        name: (dim, list(config.axes[name]), _about(name))
        for dim, group in config.dims.items()
        for name in group
    }
    coordinates |= {
        name: ((), value, _about(name)) for name, value in config.fixed.items() if value is not None
    }
    ahead, aside = ({"units": "m", "long_name": f"cube, {way}"} for way in ("ahead", "to the left"))
    coordinates |= {
        "position": np.arange(len(cubes)),
        "repeat": np.arange(config.repeats),
        "cube_x": ("position", cubes[:, 0], ahead),
        "cube_y": ("position", cubes[:, 1], aside),
    }
    if config.demonstrations is None:  # a file of records does not contain the cubes' positions
        coordinates["demonstrated_x"] = ("demonstration", DEMONSTRATED[:, 0], ahead)
        coordinates["demonstrated_y"] = ("demonstration", DEMONSTRATED[:, 1], aside)
    return coordinates


def _about(name: str) -> dict[str, str]:
    factor = FACTORS[name]
    about = {"symbol": factor.symbol, "long_name": factor.long_name}
    return about | ({"units": factor.units} if factor.units else {})
