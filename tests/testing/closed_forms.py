"""What the closed-form tests share: meshes, the exact solution as functions of time, and the comparison."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go

Array = NDArray[np.float64]
Signal = Callable[[Array], Array]

SCHEMES = ("LG", "LGR", "LGL")

LINEAR_MESHES = {"mixed": go.Mesh((0.0, 0.25, 0.4, 1.0), (4, 5, 6))}
"""For solutions that are polynomials of degree <= 3 in time: every scheme is exact on them."""

SMOOTH_MESHES = {"mixed": go.Mesh((0.0, 0.3, 0.45, 1.0), (9, 7, 11))}
"""For entire functions of time, over a few time constants: error below 1e-9 in every scheme."""


@dataclass(frozen=True)
class Truth:
    """The exact solution of one phase; every function takes times (n,) and returns values (n,)."""

    objective: float
    states: Mapping[str, Signal] = field(default_factory=dict)
    controls: Mapping[str, Signal] = field(default_factory=dict)
    costates: Mapping[str, Signal] = field(default_factory=dict)
    hamiltonian: Signal | None = None
    path_multipliers: Signal | None = None
    """Density of the phase's only path constraint."""


def constant(value: float) -> Signal:
    """Return the function of time that is constant."""
    return lambda t: np.full_like(t, value)


def integrate(integrand: Signal, first: float, last: float) -> float:
    """Integrate an entire function by 40 Gauss points."""
    points, weights = np.polynomial.legendre.leggauss(40)
    half = 0.5 * (last - first)
    return float(half * weights @ integrand(first + half * (1 + points)))


def solve(
    problem: go.Problem, mesh: go.Mesh | dict[str, go.Mesh], scheme: str, tolerance: float = 1e-10
) -> go.Solution:
    """Solve so tightly that what is left is the discretisation (Newton's last step goes far below 1e-10)."""
    return go.solve(
        problem, mesh=mesh, scheme=scheme, options=go.SolverOptions(tolerance=tolerance), tol=None
    )


def compare(name: str, found: Array, exact: Array, times: Array, tolerance: float) -> None:
    """Fail where |found - exact| > tolerance * max(1, |exact|); the message names the worst time."""
    error = np.abs(found - exact) / max(1.0, float(np.max(np.abs(exact))))
    worst = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
    assert error[worst] <= tolerance, (
        f"{name} is off by {error[worst]:.2e} at t = {times[worst]:.6g}: {found[worst]}, not {exact[worst]}"
    )


def assert_matches(solution: go.Solution, truth: Truth, tolerance: float, phase: str | None = None) -> None:
    """Compare all that ``truth`` has: at both ends, at the points, between them, on both sides of breaks."""
    assert abs(solution.objective - truth.objective) <= tolerance * max(1.0, abs(truth.objective))
    leg = solution.phase(phase)
    for kind, lookup, exact in (
        ("state", leg.state, truth.states),
        ("control", leg.control, truth.controls),
        ("costate of", leg.costate, truth.costates),
    ):
        for name, signal in exact.items():
            for times, side in samples(leg):
                # The exact solution may jump at a break; the limit is wanted from the side of the sample.
                compare(
                    f"{kind} {name}",
                    lookup(name)(times, side),
                    signal(inside(leg, times, side)),
                    times,
                    tolerance,
                )
    if truth.hamiltonian is not None:
        for times, side in samples(leg):
            found = np.asarray(solution.hamiltonian(times, phase, side))
            compare("H", found, truth.hamiltonian(inside(leg, times, side)), times, tolerance)
    if truth.path_multipliers is not None:
        for times, side in samples(leg):
            found = leg.path_multiplier(times, side)[0]
            compare(
                "path multiplier", found, truth.path_multipliers(inside(leg, times, side)), times, tolerance
            )
    _assert_boundary_costates(leg, truth, tolerance)


def samples(leg: go.PhaseSolution) -> list[tuple[Array, str]]:
    """Times and the side to take them from: points and 10 times per segment, and all limits at breaks."""
    within = np.concatenate([leg.point_times, leg.sample_times(10)])
    within = within[~np.isin(within, leg.breaks)]
    return [(within, "right"), (leg.breaks[:-1], "right"), (leg.breaks[1:], "left")]


def inside(leg: go.PhaseSolution, times: Array, side: str) -> Array:
    """Times moved off a break to the side they stand for, by rounding only."""
    shift = 1e-13 * leg.duration
    at_break = np.isin(times, leg.breaks)
    return np.where(at_break, times + (shift if side == "right" else -shift), times)


def _assert_boundary_costates(leg: go.PhaseSolution, truth: Truth, tolerance: float) -> None:
    for name, signal in truth.costates.items():
        row = leg.states.slice(name)
        for what, values, times, side in (
            ("start", leg.lam_start, leg.breaks[:-1], "right"),
            ("end", leg.lam_end, leg.breaks[1:], "left"),
        ):
            exact = signal(inside(leg, times, side))
            compare(f"costate of {name} at segment {what}s", values[row][0], exact, times, tolerance)
