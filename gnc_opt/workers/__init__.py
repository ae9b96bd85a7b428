"""Parallel execution of tasks: a worker pool for campaigns and searches, on any executor."""

from gnc_opt.workers.worker_pool import TaskResult, WorkerDiedError, WorkerPool
from gnc_opt.workers.worker_processes import SharedObject

__all__ = ["SharedObject", "TaskResult", "WorkerDiedError", "WorkerPool"]
