"""Sending one problem and many tasks to an executor, and keeping what was done when Ctrl-C comes."""

from __future__ import annotations

import contextlib
import itertools
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import Any, Literal, NoReturn, Protocol, TypeAlias, TypeVar

from gnc_opt.arguments import expect
from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.problem.problem import Problem
from gnc_opt.processes import prepare_worker, process_context, processes_fork

Builder: TypeAlias = Callable[[], Problem]

Source: TypeAlias = "_Here | bytes | int"
"""How a task gets at the problem: itself, a pickled builder, or its number among those inherited by a fork."""

Item = TypeVar("Item")
Answer = TypeVar("Answer")
_Item = TypeVar("_Item", contravariant=True)
_Answer = TypeVar("_Answer", covariant=True)


class Task(Protocol[_Item, _Answer]):
    """What is done with the problem and one item; must be picklable, as must be item and answer."""

    def __call__(self, problem: Problem, item: _Item, /) -> _Answer:
        """Do it."""


_INHERITED: dict[int, Problem] = {}
_NUMBERS = itertools.count()
_TURN = threading.Lock()


class Workforce:
    """An executor with a problem for all its workers; a context manager.

    Parameters
    ----------
    problem : Problem or callable
        Or a function without arguments that builds it.
    executor : Executor, "serial" or None
        None: one process per processor, of its own.

    Raises
    ------
    ArgumentError
        Neither a problem nor a builder, or no executor.
    GncOptError
        The problem cannot be sent to processes.
    """

    def __init__(self, problem: Problem | Builder, executor: Executor | Literal["serial"] | None) -> None:
        self.interrupted = False
        self.problem = _built(problem)
        self._number: int | None = None
        self._own: ProcessPoolExecutor | None = None
        self._workers: Any = None
        self._executor: Executor
        self._source: Source = _Here(self.problem)
        if executor is None:
            self._source = self._travelling(problem)
            context = process_context()
            self._workers = context.SimpleQueue()
            self._executor = self._own = ProcessPoolExecutor(
                os.cpu_count() or 1, context, initializer=prepare_worker, initargs=(self._workers,)
            )
            return
        if executor == "serial":
            self._executor = _Serial()
            return
        self._executor = expect(
            executor,
            Executor,
            "the executor of multistart()",
            'give a concurrent.futures.Executor or "serial"',
        )
        if not (isinstance(problem, Problem) or isinstance(executor, ThreadPoolExecutor)):
            self._source = _pickled(problem)

    def __enter__(self) -> Workforce:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        if self._own is not None:
            if self.interrupted or kind is not None:
                self._stop_workers()
            self._own.shutdown(cancel_futures=True)
        if self._number is not None:
            _INHERITED.pop(self._number, None)

    def run(
        self, task: Task[Item, Answer], items: Iterable[Item], show: Callable[[Answer], None]
    ) -> list[Answer | None]:
        """Do a task with every item; return the answers in order, None for those that Ctrl-C prevented.

        ``show`` is told every answer as it comes. After Ctrl-C `interrupted` is set.

        Raises
        ------
        GncOptError
            A process has died.
        """
        futures: list[Future[Answer]] = []
        told: set[Future[Answer]] = set()
        items = list(items)
        try:
            for item in items:
                futures.append(self._executor.submit(_work, task, self._source, item))
                if futures[-1].done():
                    show(futures[-1].result())
                    told.add(futures[-1])
            for future in as_completed(set(futures) - told):
                show(future.result())
        except KeyboardInterrupt:
            self.interrupted = True
            for future in futures:
                future.cancel()
        except BrokenExecutor as error:
            raise GncOptError(
                "a process of multistart() has died, perhaps for want of memory: try a coarser mesh, or "
                'executor="serial".'
            ) from error
        answers = [_answer(future) for future in futures]
        return answers + [None] * (len(items) - len(answers))

    def _stop_workers(self) -> None:
        """End the processes, whatever they are at: a solve may take long, and nobody waits for it any more."""
        while not self._workers.empty():
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._workers.get(), signal.SIGTERM)

    def _travelling(self, problem: Problem | Builder) -> Source:
        """Return how processes of our own get at the problem."""
        if processes_fork():
            self._number = next(_NUMBERS)
            _INHERITED[self._number] = self.problem
            return self._number
        if isinstance(problem, Problem):
            raise _cannot_travel(problem)
        return _pickled(problem)


@dataclass(frozen=True)
class _Here:
    """A problem that stays in this process."""

    problem: Problem

    def __reduce__(self) -> NoReturn:
        raise _cannot_travel(self.problem)


def _cannot_travel(problem: Problem) -> GncOptError:
    return GncOptError(
        f"problem '{problem.name}' cannot be sent to another process, because it holds symbols: give a function that "
        'builds it, e.g. functools.partial(build, case=2), or executor="serial".'
    )


class _Serial(Executor):
    """Does every task at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _work(task: Task[Item, Answer], source: Source, item: Item) -> Answer:
    if isinstance(source, _Here):
        with _TURN:  # its solver serves one thread at a time
            return task(source.problem, item)
    return task(_build(source) if isinstance(source, bytes) else _INHERITED[source], item)


@lru_cache(maxsize=4)
def _build(builder: bytes) -> Problem:
    """Return the problem of a pickled builder, built once per process."""
    return _built(pickle.loads(builder))


def _built(problem: Problem | Builder) -> Problem:
    if not isinstance(problem, Problem) and not callable(problem):
        raise ArgumentError(
            f"multistart() got a {type(problem).__name__} where a Problem or a function that builds one is needed."
        )
    made = problem if isinstance(problem, Problem) else problem()
    return expect(made, Problem, "what the builder returned", "return the problem")  # type: ignore[no-any-return]


def _pickled(builder: Builder) -> bytes:
    try:
        return pickle.dumps(builder)
    except Exception as error:
        raise GncOptError(
            f"the function that builds the problem cannot be sent to another process ({error}): define it with def at "
            "the top of a module, and give its arguments by functools.partial."
        ) from error


def _answer(future: Future[Answer]) -> Answer | None:
    done = future.done() and not future.cancelled() and future.exception() is None
    return future.result() if done else None
