"""Analysis of closed loops: how far errors scatter and why, how rare failures are, what loops do to frequencies."""

from gnc_opt.analysis.agreement import Agreement
from gnc_opt.analysis.covariance import LinearCovariance, linear_covariance

__all__ = ["Agreement", "LinearCovariance", "linear_covariance"]
