"""Which local minima the rendezvous has, and which of them the published numbers are.

    python -m benchmarks.validation.rendezvous_minima [--case N] [--equation printed|exact] [--n 100]

The search takes the paper's mesh; each minimum is then refined until its switch times are exact. A number of the
paper's own method (GPM) is compared with the minima on that mesh, one of GPOPS, which refines, with the exact ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import gnc_opt as go
from problems.rendezvous.model import CASES, EQUATIONS, PAPER_MESH, Equation, build
from problems.rendezvous.optimal import REFERENCE

NEARBY = 0.2
"""Minima that are slower than the best by more than this share of it stay on the coarse mesh."""

AGREES = 1e-7
"""How closely the best minimum must agree with the best known one, s."""


@dataclass(frozen=True)
class Published:
    """A number (s) of the paper's table 4 and the rank of the minimum that it is among those found, 1 for the best.

    ``ours`` is that minimum's objective on the same footing: on the paper's mesh for GPM, exact for GPOPS.
    """

    method: str
    value: float
    rank: int | None = None
    ours: float | None = None


@dataclass(frozen=True)
class GlobalOutcome:
    """The search of one case."""

    case: int
    equation: Equation
    found: go.Multistart

    @property
    def best_known(self) -> float:
        """Minimum time by exact switch times, s."""
        return REFERENCE[self.case, self.equation]["exact"].value

    @property
    def published(self) -> tuple[Published, ...]:
        """The paper's numbers of this case; none for the exact equation."""
        known = REFERENCE[self.case, self.equation]
        return tuple(self._identify(method) for method in ("GPM", "GPOPS") if f"paper {method}" in known)

    @property
    def agrees(self) -> bool:
        """Whether the best minimum is the best known one, and every published number has its minimum."""
        best = self.found.minima and abs(self.found.best.objective - self.best_known) <= AGREES
        return bool(best) and all(p.rank is not None for p in self.published)

    def _identify(self, method: str) -> Published:
        """Find the nearest minimum within the tolerance of the published number."""
        number = REFERENCE[self.case, self.equation][f"paper {method}"]
        candidates = [
            (abs(value - number.value), rank, value)
            for rank, minimum in enumerate(self.found.minima, 1)
            for value in (minimum.coarse_objectives if method == "GPM" else (minimum.objective,))
        ]
        distance, rank, value = min(candidates, default=(float("inf"), 0, 0.0))
        if distance > number.tolerance:
            return Published(method, number.value)
        return Published(method, number.value, rank, value)


def search_cases(
    cases: Sequence[int], equation: Equation = "printed", *, n: int = 100, seed: int = 1
) -> Iterator[GlobalOutcome]:
    """Search one case after the other, with one process per processor."""
    for case in cases:
        found = go.multistart(
            partial(build, case=case, equation=equation),
            n=n,
            seed=seed,
            mesh=PAPER_MESH,
            structure="bang-bang",
            max_refined=12,
            within=NEARBY,
            progress=True,
        )
        yield GlobalOutcome(case, equation, found)
        if found.interrupted:
            return


def minima_lines(outcomes: Sequence[GlobalOutcome]) -> Iterator[str]:
    """Yield a line per distinct minimum of every case, best first."""
    yield (
        f"{'case':>4} {'rank':>4} {'t_f (s)':>14} {'over best':>10} {'hits':>5} {'paths':>5} {'verdict':8} on 20x3"
    )
    for outcome in outcomes:
        for rank, minimum in enumerate(outcome.found.minima, 1):
            coarse = ", ".join(f"{value:.4f}" for value in minimum.coarse_objectives)
            over = minimum.objective - outcome.best_known
            yield (
                f"{outcome.case:4} {rank:4} {_time(minimum):>14} {over:+10.2e} {minimum.hits:5} "
                f"{minimum.trajectories:5} {minimum.check_result:8} {coarse}"
            )


def published_lines(outcomes: Sequence[GlobalOutcome]) -> Iterator[str]:
    """Yield, for each published number, which minimum it is, and how much slower than the best known (s and %)."""
    for outcome in outcomes:
        for number in outcome.published:
            over, which = number.value - outcome.best_known, "none found"
            if number.rank is not None and number.ours is not None:
                minimum = outcome.found.minima[number.rank - 1]
                over = abs(minimum.objective - outcome.best_known)
                which = f"minimum {number.rank}, {number.ours:.4f} s on the same footing, exactly {_time(minimum)} s"
            share = 100 * (number.value / outcome.best_known - 1)
            yield (
                f"case {outcome.case} {number.method:5} {number.value:g} s: {which}, slower by {over:.4f} s, "
                f"{share:+.2f} %"
            )


def _time(minimum: go.Minimum) -> str:
    """Return the minimum time (s); with three digits if it is not verified."""
    return f"{minimum.objective:.8f}" if minimum.verdict_ok else f"about {minimum.objective:.3f}"


def lines(outcomes: Sequence[GlobalOutcome]) -> Iterator[str]:
    """Yield both tables and the starts that gave no minimum."""
    yield from minima_lines(outcomes)
    yield 'Verdict "NOT ok": the conditions do not hold; "coarse": not refined, the time is that of 20x3.'
    yield from published_lines(outcomes)
    yield "Same footing: 20x3 for GPM, the paper's own mesh; exact switch times for GPOPS."
    for outcome in outcomes:
        if outcome.found.failures:
            listed = ", ".join(f"{count} {name}" for name, count in outcome.found.failures.items())
            yield f"case {outcome.case}, without a minimum: {listed}"
        if outcome.found.interrupted:
            yield f"case {outcome.case}: interrupted after {outcome.found.finished} starts"


def main(arguments: Sequence[str] | None = None) -> int:
    """Search and report; return 0 if the best and the published minima have all been found, else 1."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation.rendezvous_minima",
        description="Local minima of the rendezvous.",
    )
    parser.add_argument("--case", type=int, choices=list(CASES), help="initial position; default: all five")
    parser.add_argument("--equation", choices=EQUATIONS, default="printed", help="rotational dynamics")
    parser.add_argument("--n", type=int, default=100, help="random starts of each case")
    parser.add_argument("--seed", type=int, default=1, help="of these starts")
    options = parser.parse_args(arguments)
    cases = list(CASES) if options.case is None else [options.case]
    outcomes = list(search_cases(cases, options.equation, n=options.n, seed=options.seed))
    print(*lines(outcomes), sep="\n")
    return 0 if len(outcomes) == len(cases) and all(outcome.agrees for outcome in outcomes) else 1


if __name__ == "__main__":
    raise SystemExit(main())
