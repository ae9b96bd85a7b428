"""Studies of solutions: multistart, sweeps, continuation, sensitivity, lower bounds."""

from gnc_opt.planning.study.local_minima import Minimum
from gnc_opt.planning.study.multistart_search import Multistart, multistart
from gnc_opt.planning.study.parameter_continuation import Continuation, ContinuationStatus, continuation
from gnc_opt.planning.study.parameter_sweep import Sweep, sweep

__all__ = [
    "Continuation",
    "ContinuationStatus",
    "Minimum",
    "Multistart",
    "Sweep",
    "continuation",
    "multistart",
    "sweep",
]
