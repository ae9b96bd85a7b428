"""Many tasks side by side: one pool of workers for campaigns and searches, whatever executor they are given."""

from gnc_opt.workers.pool import Done, WorkerDied, WorkerPool
from gnc_opt.workers.processes import Shared

__all__ = ["Done", "Shared", "WorkerDied", "WorkerPool"]
