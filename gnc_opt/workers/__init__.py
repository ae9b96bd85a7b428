"""Parallel execution of tasks: a worker pool for campaigns and searches, on any executor."""

from gnc_opt.workers.pool import Done, WorkerDied, WorkerPool
from gnc_opt.workers.processes import Shared

__all__ = ["Done", "Shared", "WorkerDied", "WorkerPool"]
