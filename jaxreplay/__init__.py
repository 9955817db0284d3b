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
    from jaxreplay.records import Records as Records
    from jaxreplay.study.open import open_study as open_study

_HOME = {  # of each public name; loaded on first use, as JAX alone takes half a second
    "Belief": "jaxreplay.filter",
    "Filter": "jaxreplay.filter",
    "Params": "jaxreplay.params",
    "Records": "jaxreplay.records",
    "Replayer": "jaxreplay.loop.replayer",
    "build_filter": "jaxreplay.filter",
    "log_evidence": "jaxreplay.filter.evidence",
    "open_study": "jaxreplay.study.open",
    "replay": "jaxreplay.loop.replay",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
