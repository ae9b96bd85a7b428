"""Of several axes and several phases the verdict names the one that offends, and when."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from testing.wrong_solutions import bang_bang, moved, with_leg

import gnc_opt as go
from gnc_opt.planning.problem.interval import Interval
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial

E = 1e-2


@cache
def two_axes() -> go.Solution:
    """Rest to rest along two axes, 1 m and 2 m, in two phases of 1 s each, with the least energy."""
    model = go.Model("two axes")
    q, v, a = model.state("q", 2), model.state("v", 2), model.control("a", 2)
    model.ode({q: v, v: a})
    problem = go.Problem("there and back")
    there, back = problem.phase("there", model), problem.phase("back", model)
    there.time(0.0, 1.0)
    back.time(1.0, 2.0)
    there.initial(q=[0.0, 0.0], v=[0.0, 0.0])
    there.final(q=[1.0, 2.0], v=[0.0, 0.0])
    back.initial(q=[1.0, 2.0], v=[0.0, 0.0])
    back.final(q=[0.0, 0.0], v=[0.0, 0.0])
    energy = []
    for leg in (there, back):
        leg.bounds(a=([-30.0, -30.0], [30.0, 30.0]), v=([-9.0, -9.0], [9.0, 9.0]))
        energy.append(leg.integral(model.symbol("a")[0] ** 2 + model.symbol("a")[1] ** 2))
    problem.minimize(0.5 * (energy[0] + energy[1]))
    return go.solve(problem, mesh={"there": go.Mesh.uniform(4, 5), "back": go.Mesh.uniform(4, 5)}, tol=None)


def changed(phase: str, **fields: object) -> go.Solution:
    solution = two_axes()
    return with_leg(solution, phase, **fields)


def added(phase: str, piece: str, row: int, amount: float, segment: int) -> go.Solution:
    """Add a number to a row of states, controls or costates in one segment."""
    polynomial: PiecewisePolynomial = getattr(two_axes().phases[phase], piece)
    values = [v.copy() for v in polynomial.values]
    values[segment][row] += amount
    return changed(phase, **{piece: PiecewisePolynomial(polynomial.breaks, polynomial.nodes, tuple(values))})


def limited(phase: str, field: str, row: int, upper: float) -> go.Solution:
    box: Interval = getattr(two_axes().phases[phase], field)
    limits = box.upper.copy()
    limits[row] = upper
    return changed(phase, **{field: Interval(box.lower, limits)})


def multiplied(phase: str, field: str, row: int, column: int) -> go.Solution:
    values = getattr(two_axes().phases[phase], field)
    return changed(phase, **{field: moved(values, (row, column), 5.0)})


PLACES: list[tuple[str, Callable[[], go.Solution], str, tuple[float, float] | None]] = [
    ("dynamics", lambda: added("there", "u", 0, E, 2), "phase there, segment 3 (0.5 to 0.75 s), v[0]", None),
    ("dynamics", lambda: added("back", "u", 1, E, 1), "phase back, segment 2 (1.25 to 1.5 s), v[1]", None),
    ("limits", lambda: limited("there", "state_bounds", 3, 2.9), "phase there", (0.4, 0.6)),
    ("dynamics", lambda: limited("back", "control_bounds", 0, 5.9), "phase back, segment 4 (1.75 to 2 s)", None),
    ("stationarity", lambda: added("back", "lam", 3, E, 2), "phase back", (1.5, 1.75)),
    ("stationarity", lambda: added("there", "lam", 1, 5.0, 3), "phase there", (0.75, 0.8)),
    ("stationarity", lambda: added("there", "u", 1, E, 2), "phase there", (0.5, 0.75)),
    ("stationarity", lambda: added("back", "lam", 2, E, 0), "phase back", (1.0, 1.25)),
    ("minimum principle", lambda: added("back", "u", 0, 10.0, 3), "phase back", (1.75, 2.0)),
    ("active set", lambda: multiplied("there", "control_multipliers", 1, 7), "phase there", (0.25, 0.5)),
    ("active set", lambda: multiplied("back", "state_multipliers", 2, 12), "phase back", (1.5, 1.75)),
    ("active set", lambda: multiplied("back", "state_impulses", 3, 1), "phase back", (1.25, 1.25)),
]  # fmt: skip
LABELS = ["", "", "v[1]", "[0]", "a[1]", "q[1]", "a[1]", "a[0]", "", "a[1]", "v[0]", "v[1]"]


@pytest.mark.parametrize(("name", "wrong", "start", "span", "label"),
                         [(*place, label) for place, label in zip(PLACES, LABELS, strict=True)])  # fmt: skip
def test_place(
    name: str, wrong: Callable[[], go.Solution], start: str, span: tuple[float, float] | None, label: str
) -> None:
    assert go.verify(two_axes()).ok
    condition = go.verify(wrong())[name]
    assert condition.result is go.ConditionResult.FAIL
    assert condition.where.startswith(start) and label in condition.where
    if span is not None:
        time = float(condition.where.split("t = ")[1].split(" s")[0])
        assert span[0] - 1e-9 <= time <= span[1] + 1e-9


@pytest.mark.parametrize("phase", ["there", "back"])
@pytest.mark.parametrize("row", [0, 1, 2, 3])
def test_end_of_the_phase_and_component_that_is_missed(phase: str, row: int) -> None:
    leg = two_axes().phases[phase]
    shift = E * (np.arange(4) == row)
    box = Interval(leg.final_bounds.lower + shift, leg.final_bounds.upper + shift)
    condition = go.verify(changed(phase, final_bounds=box))["boundary conditions"]
    label = ("q[0]", "q[1]", "v[0]", "v[1]")[row]
    assert condition.where == f"phase {phase}, end, {label} off by {E:.3g}"


def test_switching_functions_at_one_time_and_many_of_one_control_and_of_several() -> None:
    """dH/da = a + lam_v vanishes along both axes; of the minimum time it is lam_v = 1 - t."""
    times = np.array([0.1, 0.6, 0.9])
    assert two_axes().switching_function("a", times, "there").shape == (2, 3)  # type: ignore[union-attr]
    assert two_axes().switching_function("a", times, "there") == pytest.approx(np.zeros((2, 3)), abs=1e-6)
    assert two_axes().switching_function("a", 0.6, "there") == pytest.approx(np.zeros(2), abs=1e-6)
    assert bang_bang().switching_function("a", times) == pytest.approx(1 - times, abs=1e-7)
    assert bang_bang().switching_function("a", 0.25) == pytest.approx(0.75, abs=1e-7)
    assert np.ndim(bang_bang().switching_function("a", 0.25)) == 0
