"""A long campaign on a Dask cluster that loses a worker, then its scheduler, and goes on from the checkpoint.

    python -m benchmarks.validation.cluster [--runs 100000] [--check 10000] [--workers 2] [--checkpoint DIR]
                                            [--json OUT]

Workload: `problems.rendezvous_tracking`, case 1, TVLQR, all dispersions. Scheduler and workers are processes of their
own. When `WORKER_DIES` of the compared runs are in the checkpoint, a worker is killed (SIGKILL); when `SCHEDULER_DIES`
of them are there, the scheduler and all workers. The campaign then returns what it has, and the same call on a new
cluster flies what is missing. The first runs, among which both happened, are flown again by processes of this machine
without any of that and have to have the same bits.

Exit code 1 if runs are missing or have other bits, if something was not killed on the way, or if the process that asks
for the campaign or a scheduler ever holds more than `MEMORY`.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client

from gnc_opt.simulation import Campaign
from problems.rendezvous_tracking import Tracking, plan

WORKER_DIES, SCHEDULER_DIES = 0.3, 0.6
"""Shares of the compared runs."""
MEMORY = 1500.0
"""Of the process that asks for the campaign and of a scheduler, at most, MB."""
_POLL, _START = 0.5, 120.0
"""How often the checkpoint is looked at, and how long a cluster may take to start, s."""


@contextmanager
def cluster(workers: int) -> Iterator[tuple[Client, int, Callable[[], None]]]:
    """Start a scheduler, and workers that are started again; yield a client, the scheduler's id, what kills all."""
    with tempfile.TemporaryDirectory() as folder:
        at = str(Path(folder) / "scheduler.json")
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        dask = [sys.executable, "-m", "dask"]
        own = ["--host", "127.0.0.1", "--scheduler-file", at, "--no-dashboard"]
        one = ["--nworkers", str(workers), "--nthreads", "1", "--local-directory", folder]
        started = [
            subprocess.Popen([*dask, "scheduler", "--port", "0", *own], **quiet),
            subprocess.Popen([*dask, "worker", *own, *one], **quiet),
        ]
        client = Client(scheduler_file=at, timeout=_START)

        def kill() -> None:
            pids = list(client.run(os.getpid).values())
            for process in started:
                process.kill()
            for pid in pids:
                os.kill(pid, signal.SIGKILL)

        try:
            client.wait_for_workers(workers, timeout=_START)
            yield client, started[0].pid, kill
        finally:
            client.close(timeout=1)
            for process in started:
                process.terminate()
                process.wait()


def fly(
    tracking: Tracking, runs: int, folder: Path, workers: int, deaths: Sequence[tuple[float, str]]
) -> tuple[Campaign, list[str], float]:
    """Fly on a new cluster; return what came back, who was killed, and the most that the scheduler held (MB).

    Parameters
    ----------
    tracking : Tracking
    runs : int
    folder : Path
        The checkpoint.
    workers : int
    deaths : sequence of tuple of float and str
        After how many runs in the checkpoint the ``"worker"`` or the ``"scheduler"`` is killed.
    """
    with cluster(workers) as (client, scheduler, kill_all):
        over, killed, held = threading.Event(), list[str](), [0.0]

        def watch() -> None:
            for after, whom in [*deaths, (np.inf, "")]:
                while stored(folder) < after and not over.wait(_POLL):
                    held[0] = max(held[0], peak_memory(scheduler))
                if over.is_set():
                    return
                if whom == "worker":
                    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
                else:
                    kill_all()
                killed.append(whom)

        watcher = threading.Thread(target=watch)
        watcher.start()
        try:
            executor = client.get_executor()
            return tracking.campaign("TVLQR", runs, 1, executor, checkpoint=folder), killed, held[0]
        finally:
            over.set()
            watcher.join()


def stored(folder: Path) -> int:
    """Return how many runs are in a checkpoint."""
    return sum(int(path.stem[17:]) - int(path.stem[5:13]) + 1 for path in folder.glob("runs * to *.npz"))


def same(campaign: Campaign, other: Campaign) -> bool:
    """Whether the runs of the shorter campaign have the bits of the longer one's first."""
    n = min(len(campaign), len(other))
    names = ("indices", "parameters", "states", "errors", "effort", "energy", "saturation_time", "variation")
    return all(
        np.array_equal(getattr(campaign, name)[..., :n], getattr(other, name)[..., :n], equal_nan=True)
        for name in names
    )


def peak_memory(process: int | None = None) -> float:
    """Return the most that a process ever held, MB; 0 if it is gone. Of another process on Linux only."""
    try:
        told = Path(f"/proc/{process or os.getpid()}/status").read_text(encoding="ascii")
    except OSError:
        return 0.0
    return float(told.partition("VmHWM:")[2].split()[0]) / 1e3 if "VmHWM:" in told else 0.0


def measure(runs: int, check: int, workers: int, folder: Path) -> dict[str, Any]:
    """Fly, kill and resume; return what is printed."""
    tracking, begin = Tracking(plan()), time.perf_counter()
    before = peak_memory()
    deaths = [(WORKER_DIES * check, "worker"), (SCHEDULER_DIES * check, "scheduler")]
    cut_short, killed, first = fly(tracking, runs, folder, workers, deaths)
    left = runs - stored(folder)
    campaign, _, second = fly(tracking, runs, folder, workers, [])
    seconds, peak = time.perf_counter() - begin, peak_memory()
    whole = tracking.campaign("TVLQR", check, 1)
    return {
        "runs": len(campaign),
        "ok": int(np.sum(campaign.ok)),
        "passed": campaign.pass_rate().rate,
        "killed": ", ".join(killed),
        "left when the scheduler was gone": left,
        "told as not flown": runs - int(np.sum(cut_short.ok)),
        "compared": check,
        "same bits": same(campaign, whole),
        "MB before": before,
        "MB at most": peak,
        "MB of a scheduler at most": max(first, second),
        "s on the clock": seconds,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly and judge; see ``python -m benchmarks.validation.cluster --help``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.validation.cluster")
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--check", type=int, default=10_000, help="runs flown again without a cluster")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--checkpoint", type=Path, metavar="DIR", help="default: a temporary folder")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the figures to a file")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        found = measure(options.runs, options.check, options.workers, options.checkpoint or Path(folder))
    for name, value in found.items():
        print(f"{name:36}{value:.1f}" if isinstance(value, float) else f"{name:36}{value}")
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    whole = found["ok"] == options.runs and found["same bits"] and found["killed"] == "worker, scheduler"
    bounded = max(found["MB at most"], found["MB of a scheduler at most"]) < MEMORY
    return int(not (whole and found["left when the scheduler was gone"] and bounded))


if __name__ == "__main__":
    raise SystemExit(main())
