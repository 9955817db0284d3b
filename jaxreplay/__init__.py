"""Replay demonstrations with a Bayesian filter over records and moments (positions on a record).

After Magnenat, Pradalier & Colas, *Towards Non-Parametric Bayesian Learning of Robot
Behaviors from Demonstration*. Equation and section numbers throughout are that paper's.
Read :mod:`jaxreplay.reference` first: section 2 in plain NumPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from jaxreplay import plane as plane  # registers the environment jaxreplay/FetchCube-v0

if TYPE_CHECKING:
    from jaxreplay.filter import Belief as Belief
    from jaxreplay.filter import Filter as Filter
    from jaxreplay.filter import build_filter as build_filter
    from jaxreplay.filter.evidence import log_evidence as log_evidence
    from jaxreplay.loop.replay import replay as replay
    from jaxreplay.loop.replayer import Replayer as Replayer
    from jaxreplay.params import Params as Params
    from jaxreplay.pictures import plot as plot
    from jaxreplay.pictures import plot_map as plot_map
    from jaxreplay.pictures import plot_records as plot_records
    from jaxreplay.pictures import watch as watch
    from jaxreplay.plane.params import PlaneParams as PlaneParams
    from jaxreplay.recordings.inspect import inspect as inspect
    from jaxreplay.recordings.read import read as read
    from jaxreplay.recordings.tune import tune as tune
    from jaxreplay.records import Records as Records
    from jaxreplay.study.config import StudyConfig as StudyConfig
    from jaxreplay.study.config import load_config as load_config
    from jaxreplay.study.open import open_study as open_study
    from jaxreplay.study.run import run_study as run_study

_HOME = {  # of each public name; loaded on first use, as JAX alone takes half a second
    "Belief": "jaxreplay.filter",
    "Filter": "jaxreplay.filter",
    "Params": "jaxreplay.params",
    "PlaneParams": "jaxreplay.plane.params",
    "Records": "jaxreplay.records",
    "Replayer": "jaxreplay.loop.replayer",
    "StudyConfig": "jaxreplay.study.config",
    "build_filter": "jaxreplay.filter",
    "inspect": "jaxreplay.recordings.inspect",
    "load_config": "jaxreplay.study.config",
    "log_evidence": "jaxreplay.filter.evidence",
    "open_study": "jaxreplay.study.open",
    "plot": "jaxreplay.pictures",
    "plot_map": "jaxreplay.pictures",
    "plot_records": "jaxreplay.pictures",
    "read": "jaxreplay.recordings.read",
    "replay": "jaxreplay.loop.replay",
    "run_study": "jaxreplay.study.run",
    "tune": "jaxreplay.recordings.tune",
    "watch": "jaxreplay.pictures",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
