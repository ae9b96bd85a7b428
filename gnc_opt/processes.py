"""Processes of one's own: how they start, and what each does first."""

from __future__ import annotations

import multiprocessing
import os
import signal
from typing import Any

_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def processes_fork() -> bool:
    """Whether new processes are copies of this one, with everything it has in memory."""
    return os.name == "posix" and os.uname().sysname == "Linux"


def process_context() -> Any:
    """Return the context of `multiprocessing` that starts processes, by forking where that is safe."""
    return multiprocessing.get_context("fork" if processes_fork() else None)


def prepare_worker(workers: Any) -> None:
    """Tell the queue who one is; Ctrl-C is the parent's business, and the processes share the processors already."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    workers.put(os.getpid())
    for name in _THREAD_COUNTS:
        os.environ[name] = "1"
