"""Rendezvous of least time between boundary values drawn at random: which of them the default call certifies.

    python -m benchmarks.validation.random_rendezvous [--seed 0] [--cases 34] [--only K ...] [--mesh 20x3]
                                         [--limit S] [--all] [--json OUT]

Drawn are the initial position (any direction, 20 to 45 m) and the final attitude (any axis, up to 150 degrees); all
else is the rendezvous of `problems`. Each is solved, refined and judged from one mesh. One that is not ok is solved
from two other meshes too: if these find a better minimum, the verdict was right; if they certify the same time or a
worse one, it was a false alarm. One that is ok and is beaten there (``--all`` solves every case three times) is told
as beaten: a local minimum, which no condition of a local verdict denies. The exit code is 1 after a false alarm.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import gnc_opt as go
from gnc_opt.spacecraft import mrp_from_axis_angle
from problems.rendezvous import build

OTHERS = ("20x4", "30x3")
"""Meshes that a case is tried on again."""

SAME = 1e-7
"""Minimum times nearer than this are one, s."""


@dataclass(frozen=True)
class Outcome:
    """What one case came to: word of the verdict, minimum time and processor time (s), conditions that are open."""

    case: int
    mesh: str
    word: str
    objective: float
    seconds: float
    open: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether the necessary conditions hold."""
        return self.word in ("ok", "minimum")


def draw(seed: int, count: int) -> list[go.Problem]:
    """Return the problems of a seed."""
    rng = np.random.default_rng(seed)
    return [_drawn(rng) for _ in range(count)]


def _drawn(rng: np.random.Generator) -> go.Problem:
    direction, axis = rng.normal(size=(2, 3))
    position = rng.uniform(20.0, 45.0) * direction / np.linalg.norm(direction)
    sigma = mrp_from_axis_angle(axis / np.linalg.norm(axis), np.radians(rng.uniform(0.0, 150.0)))
    return build(1).with_initial(r_L=list(position)).with_final(sigma=sigma)


def certify(case: int, problem: go.Problem, mesh: str, limit: float) -> Outcome:
    """Solve, refine and judge, within so many seconds."""
    begin = time.process_time()
    try:
        found = go.solve(problem, mesh=mesh, options=go.SolverOptions(max_wall_time=limit))
    except go.SolveError as error:
        found, told = None, str(error).partition("\n")[0]
    seconds = time.process_time() - begin
    if found is None:
        return Outcome(case, mesh, "no solution", float("nan"), seconds, (told,))
    verdict = go.verify(found)
    word = "minimum" if verdict.minimum else "ok" if verdict.ok else "NOT ok"
    amiss = tuple(
        f"{c.name} {c.result.value} {c.value:.2e} at {c.where}"
        for c in (*verdict.failed, *verdict.inconclusive)
    )
    return Outcome(case, mesh, word, found.objective, seconds, amiss)


def false_alarm(first: Outcome, others: Sequence[Outcome]) -> bool:
    """Whether a case that is not ok is no worse than what the other meshes certify."""
    certified = [o.objective for o in others if o.ok]
    return not first.ok and bool(certified) and first.objective <= min(certified) + SAME


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see the module's text."""
    options = _parser().parse_args(arguments)
    outcomes: list[Outcome] = []
    alarms = 0
    for case, problem in enumerate(draw(options.seed, options.cases)):
        if options.only and case not in options.only:
            continue
        first = certify(case, problem, options.mesh, options.limit)
        tried = [first]
        if options.all or not first.ok:
            tried += [certify(case, problem, mesh, options.limit) for mesh in OTHERS]
        for outcome in tried:
            _tell(outcome)
        alarms += false_alarm(first, tried[1:])
        least = min((o.objective for o in tried[1:] if o.ok), default=np.inf)
        if least < first.objective - SAME:
            print(f"     beaten by {first.objective - least:.2e} s", flush=True)
        outcomes += tried
        if options.json:
            options.json.write_text(
                json.dumps([asdict(o) for o in outcomes], indent=1) + "\n", encoding="utf-8"
            )
    own = [o for o in outcomes if o.mesh == options.mesh]
    minima, fine = sum(o.word == "minimum" for o in own), sum(o.ok for o in own)
    print(
        f"{len(own)} cases: {fine} ok, {minima} of them minima, {alarms} false alarms; "
        f"{sum(o.seconds for o in own):.0f} s of processor time, median {np.median([o.seconds for o in own]):.2f} s"
    )
    return int(alarms > 0)


def _tell(outcome: Outcome) -> None:
    print(
        f"{outcome.case:>4} {outcome.mesh} {outcome.word:<11} {outcome.objective:.9f} {outcome.seconds:7.2f} s  "
        + "; ".join(outcome.open),
        flush=True,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.random_rendezvous",
        description=(__doc__ or "").partition("\n")[0],
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", type=int, default=34, metavar="N")
    parser.add_argument("--only", type=int, nargs="+", metavar="K", help="only these of them")
    parser.add_argument("--mesh", default="20x3", metavar="KxN")
    parser.add_argument(
        "--limit", type=float, default=120.0, metavar="S", help="most wall time of one solution"
    )
    parser.add_argument("--all", action="store_true", help="solve each on the other meshes too")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the outcomes after every case")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
