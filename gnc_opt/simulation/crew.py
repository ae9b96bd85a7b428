"""Crew: flies batches of runs on an executor, in any order, and answers for every one of them.

A batch is a range of run numbers. Whoever flies it gets the same flight and draws everything from the seed and the
number of each run, so that it makes no difference who flies what.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    TimeoutError,
    as_completed,
)
from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import Any, Literal, TypeAlias

import numpy as np

from gnc_opt.arguments import expect
from gnc_opt.errors import GncOptError
from gnc_opt.model.layout import Array
from gnc_opt.processes import prepare_worker, process_context
from gnc_opt.simulation.dispersion import Dispersions, dispersed
from gnc_opt.simulation.flight import Ending, Flight

MOST_PER_BATCH = 100
"""Runs in a batch at most: what Ctrl-C can lose per process, and a step of the progress bar."""

BATCHES = 32
"""Number of batches aimed at, enough to occupy all processes evenly."""

MOST_CRASHES = 8
"""After so many runs in a row that each killed a process of its own, no more are tried."""

PATIENCE = 10.0
"""A cluster that has no workers twice in so many seconds (s) is not waited for."""

Batch: TypeAlias = range
Keep: TypeAlias = "Callable[[list[Flown]], None]"


@dataclass(frozen=True, eq=False)
class Mission:
    """What every process needs to know: the flight, and how runs differ."""

    flight: Flight
    dispersions: Dispersions
    seed: int

    def parameters(self, batch: Batch) -> Array:
        """Return the columns P (n_parameters, n) of runs."""
        flight = self.flight
        columns = [
            dispersed(self.dispersions, flight.layout, flight.nominal, self.seed, index) for index in batch
        ]
        return np.stack(columns, axis=1)

    def fly(self, batch: Batch) -> list[Flown]:
        """Fly a batch of runs; those that raise an exception are set apart from the others."""
        try:
            P = self.parameters(batch)
            return [Flown(batch, P, self.flight.final(P, [[self.seed, index] for index in batch]))]
        except Exception as error:  # whatever a dispersion or a solver in the loop does, no run is lost
            if len(batch) == 1:
                return [Flown(batch, None, None, _in_words(error))]
            return [flown for half in _halves(batch) for flown in self.fly(half)]


@dataclass(frozen=True, eq=False)
class Flown:
    """A batch of runs with their parameters and endings, or with what prevented them.

    Attributes
    ----------
    parameters : array (n_parameters, n) or None
    ending : Ending or None
    mishap : str
        Why there is no ending.
    """

    batch: Batch
    parameters: Array | None
    ending: Ending | None
    mishap: str = ""


class Crew:
    """Flies a mission; a context manager.

    Parameters
    ----------
    mission : Mission
    executor : Executor, "serial" or None
        None: one process per processor, of its own.

    Raises
    ------
    ArgumentError
        No executor.
    GncOptError
        The mission cannot be sent to processes.
    """

    def __init__(self, mission: Mission, executor: Executor | Literal["serial"] | None) -> None:
        self.mission = mission
        self.interrupted = False
        self._pids: Any = None
        self._own: ProcessPoolExecutor | None = None
        self._executor: Executor
        self._here = executor == "serial"
        if self._here:
            return
        self._packed = _packed(mission)
        if executor is None:
            self._executor = self._own = self._pool(os.cpu_count() or 1)
        else:
            self._executor = expect(
                executor,
                Executor,
                "the executor of monte_carlo()",
                'give a concurrent.futures.Executor, client.get_executor() of Dask, or "serial"',
            )

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        if self._own is not None:
            if self.interrupted or kind is not None:
                self._stop_workers()
            self._own.shutdown(cancel_futures=True)

    def fly(self, runs: int, show: Callable[[Flown], None]) -> list[Flown]:
        """Fly runs 0 to ``runs`` - 1 and return them in order, without those that Ctrl-C prevented.

        ``show`` is told every batch as it comes. After Ctrl-C `interrupted` is set.
        """
        size = min(MOST_PER_BATCH, max(1, runs // BATCHES))
        batches = [range(first, min(first + size, runs)) for first in range(0, runs, size)]
        done: dict[int, Flown] = {}

        def keep(parts: list[Flown]) -> None:
            for flown in parts:
                done[flown.batch.start] = flown
                show(flown)

        futures: dict[Future[list[Flown]], Batch] = {}
        try:
            failed = self._fly_all(batches, futures, keep)
            self._recover(failed, keep)
        except KeyboardInterrupt:
            self.interrupted = True
            for future, batch in futures.items():
                future.cancel()
                if batch.start not in done and _succeeded(future):
                    done |= {flown.batch.start: flown for flown in future.result()}
        return [done[start] for start in sorted(done)]

    # --- internals ----------------------------------------------------------------------------------------

    def _fly_all(
        self, batches: Sequence[Batch], futures: dict[Future[list[Flown]], Batch], keep: Keep
    ) -> list[Batch]:
        """Fly all batches side by side; return those that a dead process of our own left behind."""
        failed: list[Batch] = []
        for batch in batches:
            if self._here:
                keep(self.mission.fly(batch))
                continue
            try:
                futures[self._submit(batch)] = batch
            except BrokenExecutor as error:
                failed += self._left_behind(batch, error, keep)
        for future, mishap in self._ended(set(futures)):
            if mishap is None:
                keep(future.result())
            else:
                failed += self._left_behind(futures[future], mishap, keep)
        return sorted(failed, key=lambda batch: batch.start)

    def _left_behind(self, batch: Batch, error: BaseException, keep: Keep) -> list[Batch]:
        """Return what can be flown again; an executor that was given has tried as often as it is set to."""
        if self._own is not None:
            return [batch]
        died = isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"  # Dask's
        keep([Flown(batch, None, None, "its process died" if died else _in_words(error))])
        return []

    def _ended(
        self, pending: set[Future[list[Flown]]]
    ) -> Iterator[tuple[Future[list[Flown]], BaseException | None]]:
        """Yield futures with their errors as they end; those that nobody is left to work on have one, too."""
        lonely = 0
        while pending:
            try:
                for future in as_completed(pending, timeout=PATIENCE):
                    pending = pending - {future}
                    lonely = 0
                    yield future, future.exception()
            except TimeoutError:
                lonely = lonely + 1 if _deserted(self._executor) else 0
                if lonely < 2:  # workers may be on their way back
                    continue
                for future in pending:
                    future.cancel()
                    yield future, GncOptError("the cluster has no workers left")
                return

    def _submit(self, batch: Batch) -> Future[list[Flown]]:
        if self._own is not None:
            return self._own.submit(_fly_received, batch)
        return self._executor.submit(_fly_packed, self._packed, batch)

    def _recover(self, failed: Sequence[Batch], keep: Keep) -> None:
        """Fly batches again, each in a new process, halving those that kill it."""
        waiting, crashes = list(reversed(failed)), 0
        while waiting and self._own is not None:
            batch = waiting.pop()
            if crashes == MOST_CRASHES:
                keep(
                    [
                        Flown(
                            batch, None, None, f"not flown: the {crashes} runs before it killed their process"
                        )
                    ]
                )
                continue
            self._own.shutdown()
            self._own = self._pool(1)
            try:
                keep(self._submit(batch).result())
                crashes = 0
            except BrokenExecutor:
                if len(batch) > 1:
                    waiting += reversed(_halves(batch))
                else:
                    crashes += 1
                    keep([Flown(batch, None, None, "its process died")])

    def _pool(self, processes: int) -> ProcessPoolExecutor:
        context = process_context()
        self._pids = context.SimpleQueue()
        return ProcessPoolExecutor(
            processes, context, initializer=_receive, initargs=(self._pids, self._packed)
        )

    def _stop_workers(self) -> None:
        while not self._pids.empty():
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pids.get(), signal.SIGTERM)


def _succeeded(future: Future[Any]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


def _deserted(executor: Executor) -> bool:
    """Whether an executor is that of a Dask cluster that has no workers."""
    client: Any = getattr(executor, "_client", None)
    return hasattr(client, "scheduler_info") and not client.scheduler_info()["workers"]


def _halves(batch: Batch) -> tuple[Batch, Batch]:
    middle = batch.start + len(batch) // 2
    return range(batch.start, middle), range(middle, batch.stop)


def _in_words(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


def _packed(mission: Mission) -> bytes:
    try:
        return pickle.dumps(mission)
    except Exception as error:
        raise GncOptError(
            f"the campaign cannot be sent to other processes ({error}): define dispersions of your own at the top of a "
            'module, or use executor="serial".'
        ) from error


# --- in the processes -------------------------------------------------------------------------------------

_TURN = threading.Lock()
_MISSION: list[Mission] = []


def _receive(pids: Any, packed: bytes) -> None:
    """Get the mission, once per process."""
    prepare_worker(pids)
    _MISSION[:] = [pickle.loads(packed)]


def _fly_received(batch: Batch) -> list[Flown]:
    return _MISSION[0].fly(batch)


def _fly_packed(packed: bytes, batch: Batch) -> list[Flown]:
    mission = _unpacked(packed)
    with _TURN:  # a compiled flight serves one thread at a time
        return mission.fly(batch)


@lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Mission:
    return pickle.loads(packed)  # type: ignore[no-any-return]
