"""Studies: families of problems, followed along a parameter or over a grid of them."""

from gnc_opt.study.continuation import Continuation, ContinuationStatus, continue_in
from gnc_opt.study.sweep import Sweep, sweep

__all__ = ["Continuation", "ContinuationStatus", "Sweep", "continue_in", "sweep"]
