"""What all tests need: one thread, no display, no stopwatch, and a finger on Ctrl-C."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TypeAlias

import pytest
from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# A shell ignores Ctrl-C on behalf of what it starts in the background, and processes inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The time of an example depends on the machine.
settings.register_profile("gnc_opt", deadline=None, max_examples=15)
settings.load_profile("gnc_opt")

PATIENCE = 300.0
"""Longest wait for a sign of life, s; only a test that fails waits so long."""

PressWhen: TypeAlias = Callable[[Callable[[], bool]], None]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage while ten thousand tests are made, nor among them afterwards: they stay to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--first-tests", action="store_true", help="run only the first test of each file")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Measure no coverage of tests about problems: they are slow, and other tests cover the same lines."""
    if config.getoption("--first-tests"):
        first: dict[Path, pytest.Item] = {}
        for item in items:
            if not item.get_closest_marker("slow"):
                first.setdefault(item.path, item)
        items[:] = first.values()
    for item in items:
        if item.path.parent.name == "problems":
            item.add_marker("no_cover")


@pytest.fixture(autouse=True)
def search_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the folders from which a test has loaded problem files: new processes would search them first."""
    monkeypatch.setattr(sys, "path", list(sys.path))


@pytest.fixture
def blank_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save figures undrawn: for tests of text and numbers, since drawing those of a report takes a second."""

    def save_blank(figure: object, path: str | Path, **options: object) -> None:
        Path(path).write_text('<svg viewBox="0 0 1 1"><metadata></metadata></svg>', encoding="utf-8")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", save_blank)


@pytest.fixture
def ctrl_c_when() -> Iterator[PressWhen]:
    """``ctrl_c_when(condition)`` presses Ctrl-C, from a thread, as soon as the condition is true."""
    over, threads = threading.Event(), []

    def press(condition: Callable[[], bool]) -> None:
        limit = time.monotonic() + PATIENCE
        while not condition() and time.monotonic() < limit:
            if over.wait(0.001):  # the test has ended without it
                return
        os.kill(os.getpid(), signal.SIGINT)

    def start(condition: Callable[[], bool]) -> None:
        threads.append(threading.Thread(target=press, args=(condition,)))
        threads[-1].start()

    yield start
    over.set()
    for thread in threads:
        thread.join()
