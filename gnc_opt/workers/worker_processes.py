"""Worker processes of the package, and the object that their tasks share."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import shutil
import signal
import tempfile
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeAlias, TypeVar

from gnc_opt.errors import GncOptError

Object = TypeVar("Object")

Parcel: TypeAlias = "LocalParcel[Object] | bytes"
"""Shared object as sent to a worker: the object itself, or a pickled function that creates it."""


@dataclass(frozen=True, eq=False)
class SharedObject(Generic[Object]):
    """Object shared by all tasks.

    Attributes
    ----------
    value : object
    name, remedy : str
        For the error message if the object cannot be pickled.
    maker : callable, optional
        Picklable function that creates the object in another process.

    Examples
    --------
    >>> shared = SharedObject.wrap_picklable_object([1.0, 2.0], "the table", "give numbers")
    """

    value: Object
    name: str
    remedy: str
    maker: Callable[[], Object] | None = None

    @classmethod
    def wrap_picklable_object(cls, value: Object, name: str, remedy: str) -> SharedObject[Object]:
        """Return a shared object that is pickled itself."""
        return cls(value, name, remedy, partial(_get_object_of_parent_process, value))

    @property
    def parcel(self) -> LocalParcel[Object]:
        """Parcel for this process and processes that inherit its memory."""
        return LocalParcel(self.value, self._build_pickle_error(""))

    def pickle_shared_object(self) -> bytes:
        """Return the parcel for other processes.

        Raises
        ------
        GncOptError
            The object cannot be pickled.
        """
        if self.maker is None:
            raise self._build_pickle_error("")
        try:
            return pickle.dumps(self.maker)
        except Exception as error:
            raise self._build_pickle_error(f" ({error})") from error

    def _build_pickle_error(self, why: str) -> GncOptError:
        return GncOptError(f"{self.name} cannot be sent to another process{why}: {self.remedy}.")


@dataclass(frozen=True, eq=False)
class LocalParcel(Generic[Object]):
    """Parcel that cannot be pickled; the attempt raises the stored error."""

    value: Object
    error: GncOptError

    def __reduce__(self) -> NoReturn:
        raise self.error


def open_shared_object(parcel: Parcel[Any]) -> Any:
    """Return the object of a parcel; a pickled one is created once per process."""
    return parcel.value if isinstance(parcel, LocalParcel) else _unpickle_shared_object(parcel)


@lru_cache(maxsize=4)
def _unpickle_shared_object(parcel: bytes) -> Any:
    return pickle.loads(parcel)()


def _get_object_of_parent_process(value: Object) -> Object:
    return value


_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_OBJECT: list[Any] = []
"""Shared object of a worker process."""


def is_fork_default_start_method() -> bool:
    """Return whether new processes are forked from this one and inherit its memory."""
    return os.name == "posix" and os.uname().sysname == "Linux"


class WorkerProcesses:
    """Worker processes with a shared object; processes that died are replaced."""

    def __init__(self, shared: SharedObject[Any]) -> None:
        self._context: Any = multiprocessing.get_context("fork" if is_fork_default_start_method() else None)
        self._parcel: LocalParcel[Any] | Path = (
            shared.parcel if is_fork_default_start_method() else self._write_pickled_object(shared)
        )
        self._executor: ProcessPoolExecutor | None = None

    def _write_pickled_object(self, shared: SharedObject[Any]) -> Path:
        """Return a file with the pickled object; process arguments of more than 64 kB may block."""
        packed = shared.pickle_shared_object()
        try:
            folder = tempfile.mkdtemp(prefix="gnc_opt-")
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            path = Path(folder) / "shared"
            path.write_bytes(packed)
        except OSError as error:
            raise GncOptError(
                f"{shared.name} cannot be stored for other processes ({error}): free space in {tempfile.gettempdir()}, "
                "or set TMPDIR."
            ) from error
        return path

    def submit_worker_task(self, task: Callable[[Any, Any], Any], item: Any) -> Future[Any]:
        """Submit a task to the processes, one per processor."""
        if self._executor is None:
            self.restart_worker_processes(os.cpu_count() or 1)
        assert self._executor is not None
        return self._executor.submit(_run_task_in_worker, task, item)

    def restart_worker_processes(self, count: int) -> None:
        """Replace the existing processes by new ones."""
        self.end_worker_processes()
        self._executor = ProcessPoolExecutor(
            count, self._context, initializer=_initialise_worker_process, initargs=(self._parcel,)
        )

    def end_worker_processes(self, at_once: bool = False) -> None:
        """End the processes; ``at_once`` also during a task, whose result is discarded."""
        if self._executor is None:
            return
        if at_once:
            _kill_executor_processes(self._executor)
        self._executor.shutdown(cancel_futures=True)
        self._executor = None


def _kill_executor_processes(executor: Any) -> None:
    """Kill the processes of an executor; Python 3.14 has a public interface for it."""
    for process in list((executor._processes or {}).values()):
        process.terminate()
    # A process killed while it sends a result leaves a partial message; the executor waits for the rest as long as a
    # writer exists. After the processes have ended, this process has the only writer.
    if executor._result_queue is not None:
        executor._result_queue._writer.close()


# --- in the processes -------------------------------------------------------------------------------------


def _initialise_worker_process(parcel: LocalParcel[Any] | Path) -> None:
    """Get the object, ignore Ctrl-C (handled by the parent), and limit the threads to one."""
    threading.Thread(target=_exit_worker_when_parent_exits, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in _THREAD_COUNTS:
        os.environ[name] = "1"
    _OBJECT[:] = [open_shared_object(parcel.read_bytes() if isinstance(parcel, Path) else parcel)]


def _exit_worker_when_parent_exits() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_task_in_worker(task: Callable[[Any, Any], Any], item: Any) -> Any:
    return task(_OBJECT[0], item)
