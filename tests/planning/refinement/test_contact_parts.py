"""Contacts with state constraints, part by part: runs of pushes, junctions, touches that pull, excesses."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import functions, interval, phase
from testing.internals import PhaseSamples, PhaseStructure

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.planning import ArcKind, PhaseSolution
from gnc_opt.planning.optimality import state_constraints as sc
from gnc_opt.planning.refinement.arcs import contact_detection as p
from gnc_opt.planning.refinement.arcs import contacts as c
from gnc_opt.planning.refinement.arcs import junctions as j

LOW, FREE, UP = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER
MESH = SimpleNamespace(leg=SimpleNamespace(breaks=np.array([0.0, 1.0, 10.0])))


def free(order: int, pieces: int = 1, touches: Any = ()) -> PhaseStructure:
    """One control and one state from 0 to 10 s."""
    times = tuple(float(t) for t in np.linspace(0.0, 10.0, pieces + 1))
    return PhaseStructure(times, ((FREE, FREE),) * pieces, (), 1, 0, (0, order), touches, ((), (0,)))


def run(times: Any, worth: Any, kind: ArcKind = UP) -> p.Push:
    return p.Push(1, kind, np.array(times, float), np.array(worth, float))


# --- runs of pushes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("here", "found"),
    [
        ("", []),
        ("000", []),
        ("111", [(0, 3)]),
        ("0110", [(1, 3)]),
        ("1011", [(0, 1), (2, 4)]),
        ("10", [(0, 1)]),
    ],
)
def test_runs(here: str, found: Any) -> None:
    assert p.runs_of(np.array([h == "1" for h in here], dtype=bool)) == found


@pytest.mark.parametrize(
    ("runs", "joined"),
    [
        ([], []),
        ([(1, 3)], [(1, 3)]),
        ([(0, 2), (3, 5)], [(0, 5)]),
        ([(0, 2), (4, 5)], [(0, 2), (4, 5)]),  # two nodes lie between them
        ([(0, 1), (2, 3), (4, 6), (9, 10)], [(0, 6), (9, 10)]),
    ],
)
def test_runs_with_a_boundary_of_the_mesh_between_them_are_one(runs: Any, joined: Any) -> None:
    assert p._joined(runs) == joined


def test_where_a_first_order_constraint_pushes_is_an_arc() -> None:
    """It begins and ends midway between nodes."""
    added = run([2.0, 3.0, 5.0, 6.0, 7.0], [0, 1, 2, 0, 0]).added(free(1), MESH)  # type: ignore[arg-type]
    assert added.times == (0.0, 2.5, 5.5, 10.0) and [k[1] for k in added.kinds] == [FREE, UP, FREE]
    two = run([2.0, 3.0, 5.0, 6.0, 7.0], [0, 1, 0, 0, 3], LOW).added(free(1), MESH)  # type: ignore[arg-type]
    assert two.times == (0.0, 2.5, 4.0, 6.5, 7.0, 10.0)  # the last node is far from the end
    assert [k[1] for k in two.kinds] == [FREE, LOW, FREE, LOW, FREE]


@pytest.mark.parametrize(
    ("times", "worth", "ends"),
    [
        ([0.5, 1.0, 2.0], [1, 1, 0], (0.0, 1.5)),  # the phase's end is as near as the next node
        ([0.6, 1.0, 2.0], [1, 1, 0], (0.6, 1.5)),
        ([8.0, 9.0, 9.5], [0, 1, 1], (8.5, 10.0)),
        ([8.0, 9.0, 9.4], [0, 1, 1], (8.5, 9.4)),
        ([0.0, 4.0], [1, 1], (0.0, 4.0)),
    ],
)
def test_an_arc_reaches_the_phase_s_end_if_that_is_next(times: Any, worth: Any, ends: Any) -> None:
    added = run(times, worth).added(free(1), MESH)  # type: ignore[arg-type]
    (arc,) = [a for a in added.arcs("leg", ("u", "x")) if a.channel == "x"]
    assert (arc.start, arc.end) == pytest.approx(ends)


def test_a_constraint_of_second_order_touches_or_stays() -> None:
    """Pushes at `FEW` nodes or fewer are a touch at their centre; at more, or beside a touch, an arc over all."""
    nodes = np.linspace(2.0, 8.0, 7)
    few = run(nodes, [0, 1, 0, 3, 0, 0, 0]).added(free(2), MESH)  # type: ignore[arg-type]
    assert few.times == (0.0, 3.0, 5.0, 10.0) and few.touches == ((), ((1, UP),), ((1, UP),), ())
    one = run(nodes, [0, 1, 3, 0, 0, 0, 0]).added(free(2), MESH)  # type: ignore[arg-type]
    assert one.touching(1, UP) == pytest.approx([3.75]) and one.kinds == ((FREE, FREE),) * 2
    five = run(nodes, [0, 1, 0, 0, 0, 1, 0]).added(free(2), MESH)  # type: ignore[arg-type]
    assert five.touching(1, UP) == [3.0, 7.0]
    six = run(nodes, [1, 0, 0, 0, 0, 1, 0]).added(free(2), MESH)  # type: ignore[arg-type]
    assert six.times == (0.0, 2.0, 7.5, 10.0) and [k[1] for k in six.kinds] == [FREE, UP, FREE]
    known = free(2).with_touch(1, 2.5, UP)
    beside = run(nodes, [0, 1, 0, 0, 0, 0, 0]).added(known, MESH)  # type: ignore[arg-type]
    assert beside.times == (0.0, 2.5, 3.5, 10.0) and not beside.touching(1, UP)
    later = run(nodes, [0, 0, 0, 1, 0, 0, 0]).added(free(2).with_touch(1, 7.5, UP), MESH)  # type: ignore[arg-type]
    assert later.times == (0.0, 4.5, 7.5, 10.0)
    far = run(nodes, [0, 1, 0, 0, 0, 0, 0]).added(free(2).with_touch(1, 9.0, UP), MESH)  # type: ignore[arg-type]
    assert far.touching(1, UP) == [3.0, 9.0]


def test_a_constraint_of_third_order_touches_only() -> None:
    added = run(np.linspace(2.0, 8.0, 7), [1, 1, 1, 1, 1, 1, 1]).added(free(3), MESH)  # type: ignore[arg-type]
    assert added.touching(1, UP) == pytest.approx([5.0]) and added.kinds == ((FREE, FREE),) * 2
    for end in (0.0, 10.0):
        at_end = run([end, 5.0] if end == 0 else [5.0, end], [1, 0] if end == 0 else [0, 1])
        assert at_end.added(free(3), MESH).touches == free(3).touches  # type: ignore[arg-type]


# --- of a phase ---------------------------------------------------------------------------------------------


def climb() -> go.Problem:
    """h' = v, v' = a, and a path on h + v^2 / 2; h and that are of second and first order."""
    model = go.Model("climb")
    h, v, a = model.state("h"), model.state("v"), model.control("a")
    model.ode({h: v, v: a})
    problem = go.Problem("climb")
    leg = problem.phase("leg", model)
    leg.time(0.0, 4.0)
    leg.path("energy", h + v**2 / 2, upper=5.0)
    problem.minimize(0.5 * leg.integral(a**2))
    return problem


CLIMB = climb()


def constraints(x: Any, u: Any, lam: Any, **changes: Any) -> sc.StateConstraints:
    leg = phase(CLIMB, x, u, lam, breaks=(0.0, 1.0, 2.0, 4.0), **changes)
    return sc.StateConstraints(CLIMB, PhaseSamples.of(leg, functions(CLIMB)))


def falling(t: Array, k: int) -> Any:
    """h = 4 t - t^2, v = 4 - 2 t: at its highest, 4 m, at 2 s."""
    return [4 * t - t**2, 4 - 2 * t]


def steady(t: Array, k: int) -> Any:
    return [-2 + 0 * t]


def jumping(t: Array, k: int) -> Any:
    """lam_h is 3 before 2 s, and 1 afterwards."""
    return [1.0 + 2 * (k < 2) + 0 * t, 0 * t]


def test_values_derivatives_and_gradients_of_rows() -> None:
    here = constraints(falling, steady, jumping, state_bounds=interval([-1, -9], [4, 9]))
    assert here.size == 3 and here.bounds.upper.tolist() == [5, 4, 9]
    assert here.bounds.lower.tolist() == [-np.inf, -1, -9]
    t = np.array([0.5, 3.0])
    x, u = falling(t, 0), steady(t, 0)
    x, u = np.array(x), np.array(u)
    assert here.values(t, x, u) == pytest.approx(np.array([x[0] + x[1] ** 2 / 2, x[0], x[1]]))
    assert here.derivative(0, 1, t, x, u) == pytest.approx(x[1] + x[1] * u[0])
    assert here.derivative(1, 1, t, x, u) == pytest.approx(x[1])
    assert here.derivative(1, 2, t, x, u) == pytest.approx(u[0]) == here.derivative(2, 1, t, x, u)
    assert here.gradient(0, 0.5, x[:, 0], u[:, 0]) == pytest.approx([1.0, 3.0])
    assert here.gradient(2, 0.5, x[:, 0], u[:, 0]).tolist() == [0.0, 1.0]
    assert here.scales == pytest.approx([*here.samples.path_scale, *here.samples.state_scale])


def test_orders_count_where_limits_and_regular_controls_are() -> None:
    here = constraints(falling, steady, jumping, state_bounds=interval([-np.inf, 3], [4, 3]))
    assert [here.order(row) for row in range(3)] == [1, 2, 0]  # what is fixed is no contact
    assert [here.holders(row) for row in range(3)] == [(0,)] * 3
    free_ = constraints(falling, steady, jumping)
    assert [free_.order(row) for row in range(3)] == [1, 0, 0]
    lower = constraints(falling, steady, jumping, state_bounds=interval([-1, -np.inf], [np.inf, 9]))
    assert [lower.order(row) for row in range(3)] == [1, 2, 1]


@pytest.mark.parametrize(
    ("inside", "outside", "nodes", "found"),
    [
        (0.5, 2.0, 9, True), (0.5, -2.0, 9, True), (2.0, -2.0, 9, False), (-2.0, 0.0, 9, False), (2.0, 0.0, 9, False),
        (0.5, 2.0, 1, False), (0.5, 2.0, p.LASTING - 1, False), (0.5, 2.0, p.LASTING, True),
    ],
)  # fmt: skip
def test_a_control_that_is_on_no_limit_of_its_own_holds_the_constraint(
    monkeypatch: pytest.MonkeyPatch, inside: float, outside: float, nodes: int, found: bool
) -> None:
    """It swings by 1/2 about its mean while the constraint pushes, from 1 s to 2 s; the bounds are -2 and 2."""
    swing = 0.5 if abs(inside) < 2 else 0.0

    def u(t: Array, k: int) -> Any:
        return [inside + swing * (-1.0) ** np.arange(t.size) if k == 1 else outside + 0 * t]

    here = constraints(falling, u, jumping, control_bounds=interval([-2], [2]), degree=6)
    times = np.array([0.5, *np.linspace(1.0, 2.0, max(nodes, 2))[:nodes], 2.5])
    pushes = [p.Push(0, UP, times, np.array([0.0, *[1.0] * nodes, 0.0]))]
    monkeypatch.setattr(c, "pushing_runs", lambda *_: pushes)
    assert c.determined(CLIMB, here.samples) == ([c.Determined(0, 1.0, 2.0, 0, UP)] if found else [])


@pytest.mark.parametrize(("kind", "order", "stays"), [(FREE, 1, True), (UP, 1, False), (UP, 2, False)])
def test_an_arc_takes_a_control_that_is_free(kind: ArcKind, order: int, stays: bool) -> None:
    """With the control on its own limit a constraint of second order touches, and one of first order cannot."""
    held = PhaseStructure((0.0, 10.0), ((kind, FREE),), (), 1, 0, (0, order), (), ((), (0,)))
    pushes = run(np.linspace(2.0, 8.0, 7), [1, 1, 1, 1, 1, 1, 1])
    assert pushes.possible(held) == (stays or order > 1)
    if pushes.possible(held):
        added = pushes.added(held, MESH)  # type: ignore[arg-type]
        assert (ArcKind.UPPER in {kinds[1] for kinds in added.kinds}) == stays
        assert bool(added.touching(1, UP)) != stays


@pytest.mark.parametrize(("worth", "possible"), [([0, 0, 0, 0, 1, 1], True), ([1, 1, 1, 0, 1, 1], False)])
def test_a_control_must_be_free_where_the_constraint_pushes(worth: Any, possible: bool) -> None:
    """It is on its own limit until 5 s; what the limit does near nodes without pushes does not count."""
    kinds = ((UP, FREE), (FREE, FREE))
    held = PhaseStructure((0.0, 5.0, 10.0), kinds, (), 1, 0, (0, 1), (), ((), (0,)))
    assert run([1.0, 2.0, 3.0, 4.0, 6.0, 7.0], worth).possible(held) is possible


@pytest.mark.parametrize(("start", "begins"), [(2.0, 2.0), (2.9, 2.9), (1.0, 2.5)])
def test_an_arc_begins_where_its_control_leaves_a_bound(start: float, begins: float) -> None:
    """Within two segments of the mesh: there the control jumps to where it holds the limit."""
    kinds = ((UP, FREE), (ArcKind.SINGULAR, FREE))
    held = PhaseStructure((0.0, start, 10.0), kinds, (), 1, 0, (0, 1), (), ((), (0,)))
    fine = SimpleNamespace(leg=SimpleNamespace(breaks=np.linspace(0.0, 10.0, 21)))
    added = run([2.0, 3.0, 4.0, 5.0], [0, 1, 1, 1]).added(held, fine)  # type: ignore[arg-type]
    (arc,) = [a for a in added.arcs("leg", ("u", "x")) if a.channel == "x"]
    assert arc.start == begins


def test_a_touch_whose_limit_would_have_to_pull_is_wrong() -> None:
    """At 2 s the costate of h falls by 2: an upper limit pushes, a lower one would pull."""
    here = constraints(falling, steady, jumping, state_bounds=interval([4, -9], [4.5, 9]))
    base = PhaseStructure((0.0, 4.0), ((FREE, FREE, FREE, FREE),), (), 1, 1, (0, 0, 2, 0))
    assert c.wrong_touch(here, base.with_touch(2, 2.0, UP)) is None
    assert c.wrong_touch(here, base.with_touch(2, 2.0, LOW)) == (1, 2)
    assert c.wrong_touch(here, base.with_touch(2, 1.0, LOW)) is None  # nothing jumps there
    both = base.with_touch(2, 1.0, LOW).with_touch(2, 2.0, LOW)
    assert c.wrong_touch(here, both) == (2, 2) and c.wrong_touch(here, base) is None
    path = PhaseStructure((0.0, 4.0), ((FREE,) * 4,), (), 1, 1, (0, 2, 0, 0))
    assert c.wrong_touch(here, path.with_touch(1, 2.0, UP)) is None
    assert c.wrong_touch(here, path.with_touch(1, 2.0, LOW)) == (1, 1)


@pytest.mark.parametrize(
    ("kinds", "time"),
    [((FREE, UP), 2.25), ((UP, FREE), 1.75), ((FREE, LOW), 2.25)],
)
def test_a_junction_moves_to_where_the_derivative_of_the_interior_arc_vanishes(
    kinds: Any, time: float
) -> None:
    """v's first derivative is the control: 2 (t - 2.25) before 2 s, and 2 (t - 1.75) from there."""

    def u(t: Array, k: int) -> Any:
        return [2 * (t - (2.25 if k < 2 else 1.75))]

    here = constraints(falling, u, jumping)
    structure = PhaseStructure(
        (0.0, 2.0, 4.0), tuple((FREE, FREE, FREE, kind) for kind in kinds), (), 1, 1, (0, 0, 0, 1)
    )
    assert j.junction_time(here, structure, 1, 3) == pytest.approx(time, abs=1e-9)
    short = structure.at((1.9, 2.0, 4.0))
    assert j.junction_time(here, short, 1, 3) == pytest.approx(
        2.0 + np.sign(time - 2.0) * j.KINK_MAX_MOVE_SHARE * 0.1
    )
    settled = constraints(falling, lambda t, k: [0 * t], jumping)
    assert j.junction_time(settled, structure, 1, 3) == 2.0


def test_where_a_constraint_is_left() -> None:
    """h exceeds 3 m between 1 and 3 s, by a quarter of its 4 m at most."""
    here = constraints(falling, steady, jumping, state_bounds=interval([-1, -np.inf], [3, np.inf]))
    structure = PhaseStructure((0.0, 4.0), ((FREE,) * 4,), (), 1, 1, (0, 1, 2, 0), (), ((), (0,), (0,), ()))
    found = [r for r in c._excesses(here, structure) if r.row == 2]
    assert {r.kind for r in found} == {UP} and found[0].times[0] == pytest.approx(1.0, abs=0.05)
    times, worth = (np.concatenate([getattr(r, name) for r in found]) for name in ("times", "worth"))
    assert worth == pytest.approx((falling(times, 0)[0] - 3) / here.scales[1])
    assert times[-1] == pytest.approx(3.0, abs=0.3) and np.max(worth) == pytest.approx(0.25)
    known = structure.with_arc(2, 0.5, 3.5, UP)
    assert not [r for r in c._excesses(here, known) if r.row == 2]
    assert not c._excesses(here, PhaseStructure((0.0, 4.0), ((FREE,) * 4,), (), 1, 1, (0, 0, 0, 0)))
    # v^2 / 2 + h = 8 at the start is the worst of all, 3 beyond its limit of 5.
    added, what = c.crossed_contact(here, structure)
    assert added is not None and what == "contact of energy added at 0 s"
    only, what = c.crossed_contact(here, PhaseStructure((0.0, 4.0), ((FREE,) * 4,), (), 1, 1, (0, 0, 2, 0)))
    assert only is not None and what.startswith("contact of h added at 2 s")
    assert c.crossed_contact(here, known.with_arc(1, 0.0, 4.0, UP)) == (None, "")


def test_pushes_are_those_of_points_and_boundaries() -> None:
    """Densities times the weights of the points; impulses of states; paths at a boundary if both sides push."""
    impulses = np.array([[0.0, 7.0, 8.0, 0.0], [0.0, 0.0, 9.0, 0.0]])
    here = constraints(
        falling, steady, jumping, state_impulses=impulses,
        paths=lambda t, k: [(3.0 if k == 1 else 1.0 if k == 0 else -1.0) + 0 * t], states=lambda t, k: [2 + 0 * t, t],
    )  # fmt: skip
    leg: PhaseSolution = here.samples.leg
    times, values, pushes = p._at_nodes(here)
    assert np.all(np.diff(times) > 0) and times.size == 12 + 2
    at = [int(np.flatnonzero(times == t)[0]) for t in (1.0, 2.0)]
    points = np.setdiff1d(np.arange(14), at)
    assert times[points] == pytest.approx(leg.point_times)
    assert pushes[1:, at] == pytest.approx(impulses[:, 1:3])
    weights = np.concatenate([r.weights * w / 2 for r, w in zip(leg.rules, (1.0, 1.0, 2.0), strict=True)])
    assert pushes[1, points] == pytest.approx(2 * weights)
    assert pushes[2, points] == pytest.approx(leg.point_times * weights)
    last, first = weights[3], weights[4]
    assert pushes[0, at] == pytest.approx([0.5 * (1.0 * last + 3.0 * first), 0.0])
    assert values[1] == pytest.approx(falling(times, 0)[0], abs=1e-9)


def test_a_push_counts_near_the_limit_in_its_direction() -> None:
    """h is pushed down at the top, about 2 s: upper multipliers are positive. What it is told elsewhere is noise."""

    def pushed(sign: float, bounds: Any, upside_down: float = 1.0) -> sc.StateConstraints:
        return constraints(
            lambda t, k: [upside_down * v for v in falling(t, k)], steady, jumping, degree=9, state_bounds=bounds,
            states=lambda t, k: [sign * (5.0 * (np.abs(t - 2.0) < 0.1) + 0.1 * (t < 1.0)), 0 * t],
            state_impulses=sign * np.array([[0.0, 0.0, 1.0, 0.0], [0.0] * 4]),
        )  # fmt: skip

    base = PhaseStructure((0.0, 4.0), ((FREE,) * 4,), (), 1, 1, (0, 0, 2, 0))
    here = pushed(1.0, interval([-9, -9], [4, 9]))
    (found,) = c._runs_of_pushes(here, base)
    assert (found.row, found.kind) == (2, UP)
    counted = found.times[found.worth > 0]
    assert np.all(np.abs(counted - 2.0) < 0.1) and np.all(found.worth >= 0)
    assert np.max(found.worth) == pytest.approx(here.scales[1] / here.samples.cost_scale)
    assert np.all(falling(found.times, 0)[0] > 4 - sc.ACTIVE_CONSTRAINT_SHARE * here.scales[1])
    structure, what = c.pushed_contact(here, base)
    assert structure is not None and what.startswith("contact of h added at ")
    (touch,) = structure.touching(2, UP)
    assert touch == pytest.approx(2.0, abs=0.1)
    assert c.pushed_contact(pushed(-1.0, interval([-9, -9], [4, 9])), base) == (None, "")
    low = pushed(-1.0, interval([-4, -9], [9, 9]), -1.0)
    assert [r.kind for r in c._runs_of_pushes(low, base)] == [LOW]
    assert c._runs_of_pushes(here, base.with_arc(2, 1.5, 2.5, UP)) == []


@pytest.mark.parametrize(
    ("begin", "end", "runs"), [(1.3, 1.9, 1), (1.3, 2.5, 1), (1.0, 2.0, 2), (0.9, 2.5, 2)]
)
def test_a_bounce_takes_all_points_of_a_segment(begin: float, end: float, runs: int) -> None:
    """A polynomial that meets a limit at some points of a segment may swing at others, though it is an arc."""

    def off(t: Array) -> Array:
        return np.asarray((t > begin) & (t < end))

    here = constraints(
        lambda t, k: [4.0 * np.minimum(4 * t, 1.0) - 0.02 * off(t), 0 * t], steady, jumping, degree=9,
        state_bounds=interval([-9, -9], [4, 9]), states=lambda t, k: [5.0 * ((t > 0.3) & ~off(t)), 0 * t],
    )  # fmt: skip
    found = p.pushing_runs(here, [1])
    assert len(found) == runs and {run.kind for run in found} == {UP}
    pushing = np.concatenate([run.times[run.worth > 0] for run in found])
    assert not np.any(off(pushing)) and np.min(pushing) < begin and np.max(pushing) > end


@dataclass(frozen=True)
class Push:
    """A run that knows whether it can be held, whether it is known, and whether the mesh or a barrier alone pushes."""

    row: int
    times: Any
    worth: Any
    can: bool
    seen: bool
    slides: bool = False
    touched: bool = False

    def beside_touch(self, structure: Any, samples: Any) -> bool:
        return self.touched

    def beside_slide(self, structure: Any, samples: Any) -> bool:
        return self.slides

    def possible(self, structure: Any) -> bool:
        return self.can

    def known(self, structure: Any, samples: Any) -> bool:
        return self.seen


def test_runs_that_nothing_holds_or_that_are_known_are_no_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows count from the first control on; where the structure has a contact already nothing pushes."""
    structure = PhaseStructure(
        (0.0, 1.0, 2.0), ((LOW, FREE, FREE), (LOW, FREE, UP)), n_controls=1, n_paths=1, orders=(0, 0, 2)
    )
    times, worth = np.array([0.25, 0.75, 1.5]), np.array([1.0, 2.0, 3.0])
    runs = [Push(1, times, worth, can, seen) for can in (True, False) for seen in (False, True)]
    runs.append(Push(1, times, worth, True, False, True))
    runs.append(Push(1, times, worth, True, False, False, True))
    runs.append(Push(1, times[2:], worth[2:], True, False))  # on the contact alone
    asked: list[Any] = []
    monkeypatch.setattr(c, "pushing_runs", lambda constraints, rows: asked.append(list(rows)) or runs)
    (found,) = c._runs_of_pushes(SimpleNamespace(samples=None), structure)  # type: ignore[arg-type]
    assert asked == [[1]] and found.row == 2 and found.worth.tolist() == [1.0, 2.0, 0.0]
    assert (found.can, found.seen, found.slides, found.touched) == (True, *[False] * 3)  # type: ignore[attr-defined]
