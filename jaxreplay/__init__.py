"""Replay demonstrations with a Bayesian filter over records and moments.

After Magnenat, Pradalier & Colas, *Towards Non-Parametric Bayesian Learning of Robot
Behaviors from Demonstration*. Equation and section numbers throughout are that paper's.
"""

from jaxreplay.filter import Belief, Filter, build_filter
from jaxreplay.live import Replayer
from jaxreplay.offline import log_evidence
from jaxreplay.params import Params
from jaxreplay.records import Records
from jaxreplay.study import open_study

__all__ = [
    "Belief",
    "Filter",
    "Params",
    "Records",
    "Replayer",
    "build_filter",
    "log_evidence",
    "open_study",
]
