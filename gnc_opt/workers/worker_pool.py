"""WorkerPool: execution of tasks on an executor, with a result or an error for every task."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Generic, Literal, TypeAlias, TypeVar

from gnc_opt.argument_checks import require_type
from gnc_opt.errors import GncOptError
from gnc_opt.workers.worker_processes import Object, Parcel, SharedObject, WorkerProcesses, open_shared_object

MAX_CRASHES = 8
"""Number of consecutive items that killed their own process, after which no more items are tried."""

MAX_PENDING = 32
"""Largest number of unfinished items per executor, unless it has more than half as many threads."""

NO_WORKERS_MAX_WAIT_S = 10.0
"""Interval (s) between two checks for workers; a cluster without workers at both counts as lost."""

Item = TypeVar("Item")
Answer = TypeVar("Answer")

Task: TypeAlias = Callable[[Object, Item], Answer]
Split: TypeAlias = Callable[[Item], Sequence[Item]]

Place: TypeAlias = tuple[int, ...]
"""Index of an item; a part of a split item has the index of the item and of the part."""


class WorkerDiedError(GncOptError):
    """Error of a task whose process died, or for which no worker is left."""


@dataclass(frozen=True, eq=False)
class TaskResult(Generic[Item, Answer]):
    """Item with its answer or its error.

    Attributes
    ----------
    item : object
    answer : object or None
    error : BaseException or None
        Exception of the task, or `WorkerDiedError`.

    Examples
    --------
    >>> def shares(whole, item):
    ...     return whole / item
    >>> with WorkerPool(SharedObject.wrap_picklable_object(6, "the whole", ""), "serial", "shares()") as pool:
    ...     half, lost = pool.map(shares, [2, 0], show=lambda done: None)
    >>> print(half.answer, type(lost.error).__name__)
    3.0 ZeroDivisionError
    """

    item: Item
    answer: Answer | None = None
    error: BaseException | None = None


class WorkerPool(Generic[Object]):
    """Pool of workers that share one object; a context manager.

    Tasks are functions ``task(object, item)``; all must be picklable.

    Parameters
    ----------
    shared : SharedObject
    executor : Executor, "serial" or None
        None: one process per processor.
    caller : str
        Name for messages, e.g. ``"monte_carlo()"``.

    Attributes
    ----------
    interrupted : bool
        Whether the run was interrupted by Ctrl-C.

    Examples
    --------
    >>> with WorkerPool(SharedObject.wrap_picklable_object(10, "the base", ""), "serial", "powers()") as pool:
    ...     powers = pool.map(pow, [1, 2, 3], show=lambda done: print(done.item, done.answer))
    1 10
    2 100
    3 1000
    """

    def __init__(
        self, shared: SharedObject[Object], executor: Executor | Literal["serial"] | None, caller: str
    ) -> None:
        self.interrupted = False
        self._shared = shared
        self._own: WorkerProcesses | None = None
        self._parcel: Parcel[Object] = shared.parcel
        self._executor: Executor = _SerialExecutor()
        if executor is None:
            self._own = WorkerProcesses(shared)
        elif not (isinstance(executor, str) and executor == "serial"):
            remedy = 'give a concurrent.futures.Executor, client.get_executor() of Dask, or "serial"'
            self._executor = require_type(executor, Executor, f"the executor of {caller}", remedy)
            sends = shared.maker is not None and not isinstance(executor, ThreadPoolExecutor)
            if sends or isinstance(
                executor, ProcessPoolExecutor
            ):  # ProcessPoolExecutor may hang if pickling fails
                self._parcel = shared.pickle_shared_object()

    def __enter__(self) -> WorkerPool[Object]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        if self._own is not None:
            self._own.end_worker_processes(at_once=self.interrupted or kind is not None)

    def map(
        self,
        task: Task[Object, Item, Answer],
        items: Iterable[Item],
        show: Callable[[TaskResult[Item, Answer]], None],
        split: Split[Item] = lambda item: (),
    ) -> list[TaskResult[Item, Answer]]:
        """Return the results of a task for all items, in order, without those cancelled by Ctrl-C (`interrupted`).

        Items whose process died run again, each in a new process; an item that kills it too is split. If the given
        executor breaks, the pool's own processes execute the remaining tasks.

        Parameters
        ----------
        task : callable
        items : iterable
        show : callable
            Called with each result. An exception in it ends the run.
        split : callable, optional
            Returns parts of an item that together give the same result.
        """
        items = list(items)
        ledger = _TaskResults(items, show)
        try:
            left = self._run_tasks_in_parallel(task, list(enumerate(items)), ledger)
            if left and self._own is None:
                self._own = WorkerProcesses(self._shared)
                left = self._run_tasks_in_parallel(task, left, ledger)
            again: list[tuple[Place, Item]] = [((number,), item) for number, item in left]
            self._retry_tasks_in_new_processes(task, again, split, ledger)
        except KeyboardInterrupt:
            self.interrupted = True
            if self._own is None:
                ledger.cancel_pending_tasks()
            else:  # executors with terminating processes fail on futures cancelled one by one
                self._own.end_worker_processes(at_once=True)
            ledger.store_finished_task_results()
        return ledger.sort_task_results()

    def _run_tasks_in_parallel(
        self,
        task: Task[Object, Item, Answer],
        items: Sequence[tuple[int, Item]],
        ledger: _TaskResults[Item, Answer],
    ) -> list[tuple[int, Item]]:
        left: list[tuple[int, Item]] = []

        def record_task_result(number: int, error: BaseException | None) -> None:
            future = ledger.futures.pop(
                number
            )  # a Dask cluster keeps task and answer as long as the future is referenced
            if isinstance(error, BrokenExecutor):
                left.append((number, ledger.items[number]))
            else:
                ledger.store_task_result((number,), _build_task_result(ledger.items[number], future, error))

        waiting, pending, room = (
            deque(items),
            dict[Future[Answer], int](),
            _count_concurrent_tasks(self._executor),
        )
        idle, deserted = 0, False
        while waiting or pending:
            while waiting and len(pending) < room:
                number, item = waiting.popleft()
                future = (
                    _create_future_of_dead_worker() if deserted else self._submit_task_to_executor(task, item)
                )
                ledger.futures[number] = future
                if future.done():
                    record_task_result(number, _get_task_exception(future))
                else:
                    pending[future] = number
            ended, _ = wait(pending, timeout=NO_WORKERS_MAX_WAIT_S, return_when=FIRST_COMPLETED)
            idle = idle + 1 if pending and not ended and _has_no_cluster_workers(self._executor) else 0
            if idle == 2:  # workers may have been restarting
                deserted, ended = True, set(pending)
            for future in ended:
                number = pending.pop(future)
                if deserted:
                    future.cancel()
                record_task_result(
                    number,
                    _create_future_of_dead_worker().exception() if deserted else _get_task_exception(future),
                )
        return sorted(left, key=lambda numbered: numbered[0])

    def _retry_tasks_in_new_processes(
        self,
        task: Task[Object, Item, Answer],
        left: Sequence[tuple[Place, Item]],
        split: Split[Item],
        ledger: _TaskResults[Item, Answer],
    ) -> None:
        """Execute items again, each in a new process, and split those that kill it."""
        waiting, crashes = list(reversed(left)), 0
        while waiting and self._own is not None:
            place, item = waiting.pop()
            if crashes == MAX_CRASHES:
                why = f"not tried, since the {crashes} previous items killed their process"
                ledger.store_task_result(place, TaskResult(item, error=WorkerDiedError(why)))
                continue
            self._own.restart_worker_processes(1)
            future = self._submit_task_to_executor(task, item)
            done = _build_task_result(item, future, _get_task_exception(future))
            died = isinstance(done.error, WorkerDiedError)
            parts = split(item) if died else ()
            if parts:
                waiting += [((*place, i), part) for i, part in reversed(list(enumerate(parts)))]
                continue
            crashes = crashes + 1 if died else 0
            ledger.store_task_result(place, done)
        if left and self._own is not None:
            self._own.end_worker_processes()  # the next run starts with the full number of processes

    def _submit_task_to_executor(self, task: Task[Object, Item, Answer], item: Item) -> Future[Answer]:
        try:
            if self._own is not None:
                return self._own.submit_worker_task(task, item)
            return self._executor.submit(_run_task_serially, task, self._parcel, item)
        except BrokenExecutor as error:
            return _create_failed_future(error)
        except Exception:
            if not _has_no_cluster_workers(self._executor):
                raise
            return _create_future_of_dead_worker()


@dataclass(eq=False)
class _TaskResults(Generic[Item, Answer]):
    items: Sequence[Item]
    show: Callable[[TaskResult[Item, Answer]], None]
    futures: dict[int, Future[Answer]] = field(default_factory=dict)
    done: dict[Place, TaskResult[Item, Answer]] = field(default_factory=dict)

    def store_task_result(self, place: Place, done: TaskResult[Item, Answer]) -> None:
        self.done[place] = done
        self.show(done)

    def cancel_pending_tasks(self) -> None:
        for future in self.futures.values():
            future.cancel()

    def store_finished_task_results(self) -> None:
        """Store answers that have not been read."""
        for number, future in self.futures.items():
            if (number,) not in self.done and future.done() and _get_task_exception(future) is None:
                self.done[number,] = TaskResult(self.items[number], future.result())

    def sort_task_results(self) -> list[TaskResult[Item, Answer]]:
        return [self.done[place] for place in sorted(self.done)]


class _SerialExecutor(Executor):
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _build_task_result(
    item: Item, future: Future[Answer], error: BaseException | None
) -> TaskResult[Item, Answer]:
    if isinstance(error, KeyboardInterrupt):  # Ctrl-C in the task itself
        raise error
    if error is None:
        return TaskResult(item, future.result())
    died = isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"  # Dask's
    return TaskResult(item, error=WorkerDiedError("its process died") if died else error)


def _get_task_exception(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _create_failed_future(error: BaseException) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_exception(error)
    return future


def _create_future_of_dead_worker() -> Future[Any]:
    return _create_failed_future(WorkerDiedError("the cluster has no workers left"))


def _has_no_cluster_workers(executor: Executor) -> bool:
    """Return whether an executor belongs to a Dask cluster without workers or scheduler."""
    client: Any = getattr(executor, "_client", None)
    if not hasattr(client, "scheduler_info"):
        return False
    return getattr(client, "status", "running") != "running" or not client.scheduler_info().get("workers")


def _count_concurrent_tasks(executor: Executor) -> int:
    """Return the largest number of simultaneous tasks of an executor; each holds a copy of the shared object."""
    client: Any = getattr(executor, "_client", None)
    threads = sum(client.nthreads().values()) if hasattr(client, "nthreads") else (os.cpu_count() or 1)
    return max(MAX_PENDING, 2 * threads)


_SERIAL_LOCK = threading.RLock()


def _run_task_serially(task: Callable[[Any, Any], Any], parcel: Parcel[Any], item: Any) -> Any:
    with _SERIAL_LOCK:  # compiled functions are not thread-safe
        return task(open_shared_object(parcel), item)
