"""Many solutions, or derivatives of one: multistart, sweeps, continuation, sensitivity, lower bounds."""

from gnc_opt.planning.study.continuation import Continuation, ContinuationStatus, continue_in
from gnc_opt.planning.study.minima import Minimum
from gnc_opt.planning.study.multistart import Multistart, multistart
from gnc_opt.planning.study.sweep import Sweep, sweep

__all__ = [
    "Continuation",
    "ContinuationStatus",
    "Minimum",
    "Multistart",
    "Sweep",
    "continue_in",
    "multistart",
    "sweep",
]
