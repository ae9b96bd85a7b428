"""One pool for campaigns and searches: every item is answered for, whoever does it and whatever happens to him."""

from __future__ import annotations

import errno
import gc
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from gnc_opt.errors import ArgumentError, GncOptError
from gnc_opt.workers import (
    SharedObject,
    TaskResult,
    WorkerDiedError,
    WorkerPool,
    worker_pool,
    worker_processes,
)

pytestmark = pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")

KINDS = ["serial", "own", "threads", "processes"]


@contextmanager
def executor(kind: str) -> Iterator[Any]:
    if kind in ("threads", "processes"):
        with {"threads": ThreadPoolExecutor, "processes": ProcessPoolExecutor}[kind](2) as given:
            yield given
    else:
        yield "serial" if kind == "serial" else None


def last(values: Any, index: int) -> int:
    return int(values[-1]) + index


def shared(value: Any = 10) -> SharedObject[Any]:
    return SharedObject.wrap_picklable_object(value, "the number", "take another one")


def workers(kind: Any = None, value: Any = 10) -> WorkerPool[Any]:
    return WorkerPool(shared(value), kind, "try_it()")


def ignore(done: TaskResult[Any, Any]) -> None:
    pass


def times(number: int, item: int) -> int:
    if item % 5 == 3:
        raise ValueError(f"no {item}")
    return number * item


@pytest.mark.parametrize("kind", KINDS)
def test_answers_and_errors_come_in_the_order_of_the_items_and_are_shown_once(kind: str) -> None:
    shown: list[int] = []
    with executor(kind) as given, workers(given) as force:
        done = force.map(times, range(20), lambda each: shown.append(each.item))
    assert [each.item for each in done] == list(range(20)) == sorted(shown)
    for each in done:
        if each.item % 5 == 3:
            assert isinstance(each.error, ValueError) and str(each.error) == f"no {each.item}"
            assert each.answer is None
        else:
            assert (each.answer, each.error) == (10 * each.item, None)
    assert not force.interrupted and not multiprocessing.active_children()


def whereabouts(_: Any, item: int) -> tuple[int, int | None, str]:
    return os.getpid(), threading.get_ident(), os.environ.get("OMP_NUM_THREADS", "")


def test_where_the_work_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    found = {}
    for kind in KINDS:
        with executor(kind) as given, workers(given) as force:
            found[kind] = [each.answer for each in force.map(whereabouts, range(8), ignore)]
    assert {(pid, thread) for pid, thread, _ in found["serial"]} == {(os.getpid(), threading.get_ident())}
    assert {pid for pid, _, _ in found["threads"]} == {os.getpid()}
    assert threading.get_ident() not in {thread for _, thread, _ in found["threads"]}
    for kind in ("own", "processes"):
        assert os.getpid() not in {pid for pid, _, _ in found[kind]}
    assert {limit for _, _, limit in found["own"]} == {"1"}  # the processes share the processors already


def test_show_may_end_the_run(tmp_path: Path) -> None:
    def refuse(done: TaskResult[int, int]) -> None:
        raise GncOptError("enough")

    unfinished = tmp_path / "finished"
    with pytest.raises(GncOptError, match="enough"), workers(value=unfinished) as force:
        force.map(_first_at_once, range(2), refuse)
    assert not multiprocessing.active_children()
    assert not unfinished.exists()  # nobody waits for what is no longer wanted


def _first_at_once(path: Path, item: int) -> None:
    if item:
        time.sleep(20.0)
        path.touch()


@pytest.mark.parametrize("wrong", ["threads", 3, np.zeros(2), ca.SX.sym("x"), ThreadPoolExecutor])
def test_an_executor_must_be_one(wrong: Any) -> None:
    with pytest.raises(ArgumentError, match=r"the executor of try_it\(\) must be of type Executor, not .*"):
        workers(wrong)


class Counted:
    """Knows how often it was made in its process."""

    made = 0

    def __init__(self) -> None:
        Counted.made += 1

    def tell(self, item: int) -> tuple[int, int]:
        return os.getpid(), Counted.made


def test_the_object_is_made_once_per_process() -> None:
    Counted.made = 0
    counted = SharedObject(Counted(), "it", "do not", Counted)
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as given,
        WorkerPool(counted, given, "try_it()") as force,
    ):
        answers = {each.answer for each in force.map(Counted.tell, range(6), ignore)}
    ((pid, made),) = answers
    assert pid != os.getpid() and made == 1


def plus(function: Any, item: int) -> Any:
    return function(item)


def test_what_cannot_travel_is_named_with_a_remedy() -> None:
    local = SharedObject.wrap_picklable_object(lambda x: x + 1, "the function", "write def")
    with ProcessPoolExecutor(1) as given:
        with pytest.raises(
            GncOptError, match=r"^the function cannot be sent to another process \(.*\): write def\.$"
        ):
            WorkerPool(local, given, "try_it()")
        stuck = SharedObject(lambda x: x + 1, "the function", "write def")
        refused = r"^the function cannot be sent to another process: write def\.$"
        with pytest.raises(GncOptError, match=refused):
            WorkerPool(stuck, given, "try_it()")
        with pytest.raises(GncOptError, match=refused):  # by other executors, which may stay in this process
            pickle.dumps(stuck.parcel)
    for kind in ("serial", "threads"):  # where nothing is sent, nothing has to be picklable
        with executor(kind) as given, WorkerPool(local, given, "try_it()") as force:
            assert [each.answer for each in force.map(plus, [1, 2], ignore)] == [2, 3]


@pytest.mark.parametrize("forks", [True, False])
def test_own_processes_inherit_the_object_where_they_fork(
    monkeypatch: pytest.MonkeyPatch, forks: bool
) -> None:
    if forks and not worker_processes.is_fork_default_start_method():
        pytest.skip("processes do not fork here")
    monkeypatch.setattr(worker_processes, "is_fork_default_start_method", lambda: forks)
    local = SharedObject.wrap_picklable_object(lambda x: x + 1, "the function", "write def")
    if forks:
        with WorkerPool(local, None, "try_it()") as force:
            assert [each.answer for each in force.map(plus, [1, 2], ignore)] == [2, 3]
    else:
        with pytest.raises(GncOptError, match="cannot be sent"):
            WorkerPool(local, None, "try_it()")
        with workers() as force:  # but what can be sent is
            assert [each.answer for each in force.map(times, [1, 2], ignore)] == [10, 20]


@pytest.mark.parametrize("numbers", [10, 100_000])
def test_a_shared_object_larger_than_a_pipe_reaches_spawned_processes_and_leaves_no_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, numbers: int
) -> None:
    monkeypatch.setattr(worker_processes, "is_fork_default_start_method", lambda: False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with WorkerPool(shared(np.arange(numbers)), None, "try_it()") as force:
        assert len(list(tmp_path.iterdir())) == 1
        (done,) = force.map(last, [0], ignore)
        assert done.answer == numbers - 1
    del force
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_an_error_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_processes, "is_fork_default_start_method", lambda: False)

    def full(*_: Any, **__: Any) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "mkdtemp", full)
    with pytest.raises(
        GncOptError, match=r"the number cannot be stored for other processes .*No space.*TMPDIR"
    ):
        WorkerPool(shared(), None, "try_it()")


def survive(deadly: set[int], batch: range) -> list[int]:
    """Return the numbers of a batch; a deadly one among them kills a process other than the main one."""
    if deadly & set(batch) and multiprocessing.parent_process() is not None:
        os._exit(1)
    return list(batch)


def halves(batch: range) -> tuple[range, ...]:
    middle = (batch.start + batch.stop) // 2
    return (range(batch.start, middle), range(middle, batch.stop)) if len(batch) > 1 else ()


BATCHES = [range(first, first + 8) for first in range(0, 64, 8)]


def test_items_that_kill_their_process_are_found_and_the_others_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    with workers(value={5, 41, 42}) as force:
        shown: list[Any] = []
        done = force.map(survive, BATCHES, shown.append, halves)
        lost = [each for each in done if each.error is not None]
        assert [list(each.item) for each in lost] == [[5], [41], [42]]
        assert all(
            isinstance(each.error, WorkerDiedError) and str(each.error) == "its process died" for each in lost
        )
        assert [number for each in done for number in each.item] == list(range(64))  # in order
        assert all(each.answer == list(each.item) for each in done if each.error is None)
        assert sorted(id(each) for each in shown) == sorted(id(each) for each in done)
        # and the pool is as wide as before
        assert [each.answer for each in force.map(survive, [range(43, 45)], ignore)] == [[43, 44]]
        assert len(multiprocessing.active_children()) == 3
    assert not multiprocessing.active_children()


def test_no_more_items_are_tried_after_several_in_a_row_that_kill_their_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("gnc_opt.workers.worker_pool.MAX_CRASHES", 2)
    with workers(value={0, 1, 2, 3}) as force:
        done = force.map(survive, [range(k, k + 1) for k in range(4)], ignore, halves)
    untried = "not tried, since the 2 previous items killed their process"
    assert [str(each.error) for each in done] == ["its process died"] * 2 + [untried] * 2


def test_an_item_that_kills_once_is_done_the_second_time(tmp_path: Path) -> None:
    with workers(value=str(tmp_path / "flag")) as force:
        done = force.map(_die_once, range(6), ignore)
    assert [each.answer for each in done] == list(range(6))


def _die_once(flag: str, item: int) -> int:
    if item == 2 and not os.path.exists(flag):
        open(flag, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def test_what_a_broken_executor_leaves_is_done_by_processes_of_our_own() -> None:
    with ProcessPoolExecutor(1) as given, workers(given, {9}) as force:
        done = force.map(survive, BATCHES, ignore, halves)
        assert [list(each.item) for each in done if each.error is not None] == [[9]]
        assert [number for each in done for number in each.item] == list(range(64))
        assert all(each.answer == list(each.item) for each in done if each.error is None)
        again = force.map(survive, BATCHES[:1], ignore, halves)
        assert again[0].answer == list(BATCHES[0])
    assert not multiprocessing.active_children()


ORPHANS = """
import os, sys, time
from gnc_opt.workers import SharedObject, WorkerPool
def nap(folder, item):
    open(os.path.join(folder, str(os.getpid())), "w").close()
    time.sleep(60)
os.cpu_count = lambda: 3
shared = SharedObject.wrap_picklable_object(sys.argv[1], "a folder", "")
with WorkerPool(shared, None, "me") as pool:
    pool.map(nap, range(6), print)
"""


@pytest.mark.skipif(os.name != "posix", reason="kills processes")
def test_no_worker_outlives_a_main_process_that_is_killed(tmp_path: Path) -> None:
    main = subprocess.Popen([sys.executable, "-c", ORPHANS, str(tmp_path)])
    try:
        _wait_for(lambda: len(list(tmp_path.iterdir())) == 3)
    finally:
        main.kill()
        main.wait()
    workers_of_it = [int(path.name) for path in tmp_path.iterdir()]
    _wait_for(lambda: not any(_alive(pid) for pid in workers_of_it))


def _alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked about does not."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


def _wait_for(true: Any, patience: float = 30.0) -> None:
    end = time.monotonic() + patience
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


class Deserted(Executor):
    """Takes tasks and does none, like a Dask cluster whose workers are gone."""

    class _client:
        @staticmethod
        def scheduler_info() -> dict[str, Any]:
            return {"workers": {}}

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        return Future()


def test_a_cluster_without_workers_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_pool, "NO_WORKERS_MAX_WAIT_S", 0.05)
    with workers(Deserted()) as force:
        done = force.map(times, range(3), ignore)
    assert [str(each.error) for each in done] == ["the cluster has no workers left"] * 3


class Returning(Deserted):
    """A cluster whose workers come back when one has asked for them once."""

    def __init__(self) -> None:
        self._client = self  # type: ignore[assignment]
        self.tasks: list[Any] = []
        self.asked = 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.tasks.append((future, partial(fn, *args, **kwargs)))
        return future

    def scheduler_info(self) -> dict[str, Any]:
        self.asked += 1
        if self.asked == 1:
            return {"workers": {}}
        for future, task in self.tasks:
            future.set_result(task())
        return {"workers": {"one": {}}}


def test_workers_on_their_way_back_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_pool, "NO_WORKERS_MAX_WAIT_S", 0.05)
    with workers(Returning()) as force:
        done = force.map(times, range(3), ignore)
    assert [each.answer for each in done] == [0, 10, 20]


class Counting(Executor):
    """Does every task a little later; counts what it holds meanwhile."""

    def __init__(self, threads: int = 0) -> None:
        self.held: list[Future[Any]] = []
        self.given: list[weakref.ref[Future[Any]]] = []
        self.most, self.alive = 0, 0
        if threads:
            self._client = SimpleNamespace(nthreads=lambda: {"one": threads})

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.held = [each for each in self.held if not each.done()] + [future]
        self.given.append(weakref.ref(future))
        self.most = max(self.most, len(self.held))
        self.alive = max(self.alive, sum(each() is not None for each in self.given))
        threading.Timer(0.02, lambda: future.set_result(fn(*args, **kwargs))).start()
        return future


@pytest.mark.parametrize(("threads", "most"), [(0, 5), (4, 8)])
def test_an_executor_holds_no_more_tasks_than_it_needs(
    monkeypatch: pytest.MonkeyPatch, threads: int, most: int
) -> None:
    """Each task carries what all of them share: the memory of a campaign on a cluster does not grow with its runs."""
    monkeypatch.setattr(worker_pool, "MAX_PENDING", 5)
    monkeypatch.setattr(worker_pool.os, "cpu_count", lambda: 2)
    executor = Counting(threads)
    with workers(executor) as force:
        done = force.map(pow, range(30), ignore)
    assert [each.answer for each in done] == [10**k for k in range(30)]
    assert 1 < executor.most <= most
    assert executor.alive <= 2 * most + 2  # some that are done are still held by those who did them


@pytest.mark.parametrize("kind", ["serial", "own", "threads"])
def test_ctrl_c_keeps_what_is_done(kind: str) -> None:
    shown: list[int] = []

    def show(done: TaskResult[int, int]) -> None:
        shown.append(done.item)
        if len(shown) == 4:
            signal.raise_signal(signal.SIGINT)

    with executor(kind) as given, workers(given) as force:
        done = force.map(partial(_slowly, 0.01), range(500), show)
    assert force.interrupted and 4 <= len(done) < 500
    assert kind != "serial" or len(done) == 4  # also the one that was being shown
    assert set(shown) <= {each.item for each in done}
    assert [each.item for each in done] == sorted(each.item for each in done)
    assert all(each.answer == 10 * each.item for each in done)
    assert not multiprocessing.active_children()


def _slowly(pause: float, number: int, item: int) -> int:
    time.sleep(pause)
    return number * item


def test_ctrl_c_is_the_parents_business() -> None:
    """At a terminal all processes get the signal: those that work must not fail over it."""
    with workers() as force:
        done = force.map(_signalled, range(4), ignore)
    assert not force.interrupted and [each.answer for each in done] == list(range(4))


def _signalled(_: int, item: int) -> int:
    signal.raise_signal(signal.SIGINT)
    return item


def test_ctrl_c_ends_workers_whatever_they_are_at(ctrl_c_when: Any, tmp_path: Path) -> None:
    crew = min(3, os.cpu_count() or 1)
    ctrl_c_when(
        lambda: len(list(tmp_path.iterdir())) == crew
    )  # CPython loses a Ctrl-C that comes while it forks
    with workers() as force:
        done = force.map(partial(_endless, tmp_path), range(3), ignore)
    assert force.interrupted and not done and not multiprocessing.active_children()


def _endless(at_work: Path, number: int, item: int) -> int:
    (at_work / str(os.getpid())).touch()
    return _slowly(1000.0, number, item)
