"""Processes of one's own, and the one object that all tasks need."""

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

Parcel: TypeAlias = "Here[Object] | bytes"
"""The object for a worker: the object itself, or a pickled function that creates it."""


@dataclass(frozen=True, eq=False)
class Shared(Generic[Object]):
    """An object for all tasks.

    Attributes
    ----------
    value : object
    name, remedy : str
        For the error if it cannot be sent to another process.
    maker : callable, optional
        Makes it in another process; must be picklable.

    Examples
    --------
    >>> shared = Shared.picklable([1.0, 2.0], "the table", "give numbers")
    """

    value: Object
    name: str
    remedy: str
    maker: Callable[[], Object] | None = None

    @classmethod
    def picklable(cls, value: Object, name: str, remedy: str) -> Shared[Object]:
        """Return an object that travels by itself."""
        return cls(value, name, remedy, partial(_return_value, value))

    @property
    def here(self) -> Here[Object]:
        """The parcel that stays in this process and in those that inherit its memory."""
        return Here(self.value, self._make_pickle_error(""))

    def pack_parcel(self) -> bytes:
        """Return the parcel for other processes.

        Raises
        ------
        GncOptError
            The object cannot be sent.
        """
        if self.maker is None:
            raise self._make_pickle_error("")
        try:
            return pickle.dumps(self.maker)
        except Exception as error:
            raise self._make_pickle_error(f" ({error})") from error

    def _make_pickle_error(self, why: str) -> GncOptError:
        return GncOptError(f"{self.name} cannot be sent to another process{why}: {self.remedy}.")


@dataclass(frozen=True, eq=False)
class Here(Generic[Object]):
    """A parcel that stays where it is; an executor that tries to send it gets the error."""

    value: Object
    error: GncOptError

    def __reduce__(self) -> NoReturn:
        raise self.error


def open_parcel(parcel: Parcel[Any]) -> Any:
    """Return the object of a parcel; one that was sent is made once per process."""
    return parcel.value if isinstance(parcel, Here) else _unpickle_once(parcel)


@lru_cache(maxsize=4)
def _unpickle_once(parcel: bytes) -> Any:
    return pickle.loads(parcel)()


def _return_value(value: Object) -> Object:
    return value


_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_OBJECT: list[Any] = []
"""In a process of ours: the shared object."""


def is_fork_default() -> bool:
    """Whether new processes are copies of this one, with everything it has in memory."""
    return os.name == "posix" and os.uname().sysname == "Linux"


class OwnProcesses:
    """Processes that have a shared object; new ones take the place of those that died."""

    def __init__(self, shared: Shared[Any]) -> None:
        self._context: Any = multiprocessing.get_context("fork" if is_fork_default() else None)
        self._parcel: Here[Any] | Path = shared.here if is_fork_default() else self._write_parcel(shared)
        self._executor: ProcessPoolExecutor | None = None

    def _write_parcel(self, shared: Shared[Any]) -> Path:
        """Return a file with the packed object: an argument of more than 64 kB may block a process."""
        packed = shared.pack_parcel()
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

    def submit_task(self, task: Callable[[Any, Any], Any], item: Any) -> Future[Any]:
        """Have a task done by one of them, as many as there are processors."""
        if self._executor is None:
            self.restart_processes(os.cpu_count() or 1)
        assert self._executor is not None
        return self._executor.submit(_run_task, task, item)

    def restart_processes(self, count: int) -> None:
        """Let new processes take the place of those there are."""
        self.end_processes()
        self._executor = ProcessPoolExecutor(
            count, self._context, initializer=_initialise_process, initargs=(self._parcel,)
        )

    def end_processes(self, at_once: bool = False) -> None:
        """End them; ``at_once`` also during a task, whose result is no longer needed."""
        if self._executor is None:
            return
        if at_once:
            _kill_processes(self._executor)
        self._executor.shutdown(cancel_futures=True)
        self._executor = None


def _kill_processes(executor: Any) -> None:
    """End the processes of an executor at once; for what it needs the public interface comes with Python 3.14."""
    for process in list((executor._processes or {}).values()):
        process.terminate()
    # One that dies while it answers leaves half an answer, for the rest of which the executor waits for ever as long
    # as anybody could write it: after the processes, that is this one alone.
    if executor._result_queue is not None:
        executor._result_queue._writer.close()


# --- in the processes -------------------------------------------------------------------------------------


def _initialise_process(parcel: Here[Any] | Path) -> None:
    """Get the object; Ctrl-C is the parent's business, and the processors are shared already."""
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in _THREAD_COUNTS:
        os.environ[name] = "1"
    _OBJECT[:] = [open_parcel(parcel.read_bytes() if isinstance(parcel, Path) else parcel)]


def _exit_with_parent() -> None:
    """End at once when the parent process is gone for any reason."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_task(task: Callable[[Any, Any], Any], item: Any) -> Any:
    return task(_OBJECT[0], item)
