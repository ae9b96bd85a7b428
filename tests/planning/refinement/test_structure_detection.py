"""Recognising a control structure from samples that are given by hand, step by step."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.constructed_solutions import cart, interval, samples
from testing.internals import PhaseSamples, optimise_switches

import gnc_opt as go
from gnc_opt.arrays import Array
from gnc_opt.planning import ArcKind
from gnc_opt.planning.refinement.arcs import curvature as b
from gnc_opt.planning.refinement.arcs import detection as d
from gnc_opt.planning.refinement.arcs.contacts import Determined
from gnc_opt.planning.refinement.arcs.structure import choose, signs_of

LOW, FREE, UP, SING = ArcKind.LOWER, ArcKind.INTERIOR, ArcKind.UPPER, ArcKind.SINGULAR
LETTERS = {"l": LOW, "i": FREE, "u": UP, "s": SING, "r": ArcKind.RELEASED}
PER_SEGMENT = 4


def kinds(text: str) -> Any:
    return np.array([LETTERS[c] for c in text], dtype=object)


def text(labels: Any) -> str:
    return "".join({kind: c for c, kind in LETTERS.items()}[kind] for kind in labels)


def sampled(segments: int, breaks: Any = None, **more: Any) -> Any:
    """Four samples to a segment of 1 s, its ends among them; one control between -1 and 1."""
    edges = np.arange(segments + 1.0) if breaks is None else np.asarray(breaks, float)
    times = np.linspace(edges[:-1], edges[1:], PER_SEGMENT, axis=1).ravel()
    values = {
        "times": times,
        "segments": np.repeat(np.arange(segments), PER_SEGMENT),
        "control_scale": np.array([2.0]),
        "u": np.zeros((1, times.size)),
        "leg": SimpleNamespace(
            breaks=edges, control_bounds=interval(-1.0, 1.0), state_bounds=interval(-np.inf, np.inf)
        ),
        "x": np.zeros((1, times.size)),
        "state_scale": np.ones(1),
        "functions": SimpleNamespace(rates=lambda t, x, u: u),
    }
    return SimpleNamespace(**(values | more))


# --- arcs that swallow their neighbours -------------------------------------------------------------------


def spread(segments: str, candidates: str = "", breaks: Any = None) -> str:
    """Singular arcs spread over labels that are given a letter to each segment."""
    labels = np.repeat(kinds(segments), PER_SEGMENT)
    allowed = np.repeat([c == "1" for c in candidates or "1" * len(segments)], PER_SEGMENT)
    d._spread(sampled(len(segments), breaks), labels, SING, allowed)
    return text(labels[::PER_SEGMENT])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("slusss", "ssssss"), ("sssul", "sssss"), ("lsssssu", "sssssss"), ("ssslluu", "ssslluu"),
        ("uuullsss", "uuullsss"), ("llluuu", "llluuu"), ("ssllss", "ssllss"), ("sslss", "sssss"), ("ssss", "ssss"),
    ],
)  # fmt: skip
def test_bangs_shorter_than_two_segments_beside_an_arc_are_swallowed(before: str, after: str) -> None:
    """One after another, from both sides; longer ones stay, and what is beside nothing."""
    assert spread(before) == after


@pytest.mark.parametrize(
    ("candidates", "after"),
    [
        ("0000000", "ssluuss"),
        ("0010000", "sssuuss"),
        ("0001100", "ssluuss"),
        ("0000100", "sslusss"),
        ("0001000", "ssluuss"),
    ],
)
def test_only_candidates_are_swallowed(candidates: str, after: str) -> None:
    assert spread("ssluuss", candidates) == after


def test_how_short_goes_by_the_longest_segment_of_the_bang() -> None:
    assert spread("slluu", breaks=[0, 1, 1.5, 3.0, 5.0, 8.0]) == "sssss"  # of 2 s beside 1.5, of 5 s beside 3
    assert spread("sllu", breaks=[0, 1, 2.0, 3.0, 9.0]) == "sllu"
    assert spread("sllll", breaks=[0, 1, 2, 3, 4, 9.0]) == "sssss"
    assert spread("sllll", breaks=[0, 1, 2, 3, 4, 6.0]) == "sllll"


def test_the_label_that_spreads_is_the_one_that_is_meant() -> None:
    labels = np.repeat(kinds("uuiiil"), PER_SEGMENT)
    d._spread(sampled(6), labels, UP, np.ones(24, dtype=bool))
    assert text(labels[::PER_SEGMENT]) == "uuiiil"
    labels = np.repeat(kinds("uuil"), PER_SEGMENT)
    d._spread(sampled(4), labels, UP, np.ones(16, dtype=bool))
    assert text(labels[::PER_SEGMENT]) == "uuuu"


def test_arcs_of_one_sample_at_the_ends_spread_too() -> None:
    for before in ("slll", "llls"):
        labels = kinds(before)
        d._spread(sampled(1), labels, SING, np.ones(4, dtype=bool))
        assert text(labels) == "ssss"


def absorbed(before: str, u: list[float], gradient: list[float]) -> str:
    labels = np.repeat(kinds(before), PER_SEGMENT)
    d._absorb(
        sampled(len(before), u=np.repeat(u, PER_SEGMENT)[None, :]),
        0,
        labels,
        np.repeat(gradient, PER_SEGMENT),
    )
    return text(labels[::PER_SEGMENT])


@pytest.mark.parametrize(
    ("u", "gradient", "after"),
    [
        (-1.0, 0.5, "sslss"), (-1.0, 0.01, "sssss"), (-1.0, -0.01, "sssss"), (-1.0, -0.5, "sslss"),
        (0.2, 0.5, "sssss"), (-0.2, 0.5, "sslss"), (1.0, 0.5, "sssss"),
    ],
)  # fmt: skip
def test_noise_and_chatter_beside_a_singular_arc_are_absorbed(u: float, gradient: float, after: str) -> None:
    """Noise: the switching function stays small. Chatter: the control is nearer to the other bound."""
    assert absorbed("sslss", [0, 0, u, 0, 0], [0, 0, gradient, 0, 0]) == after


def test_each_bang_is_judged_by_itself() -> None:
    assert absorbed("slssuss", [0, -1, 0, 0, 1, 0, 0], [0, 0.5, 0, 0, -0.01, 0, 0]) == "slsssss"
    assert absorbed("slssuss", [0, 1, 0, 0, 1, 0, 0], [0, 0.5, 0, 0, -0.5, 0, 0]) == "ssssuss"
    assert absorbed("slssuss", [0, -1, 0, 0, -1, 0, 0], [0, 0.5, 0, 0, -0.5, 0, 0]) == "slsssss"
    assert absorbed("lssu", [-1, 0, 0, 1], [0.01, 0, 0, -0.5]) == "sssu"


@pytest.mark.parametrize(
    ("speed", "moved", "after"),
    [
        ([0, 0, 0.5, 0.2, 0], True, "sslsss"), ([0, 0, 0.03, 0.02, 0], True, "ssssss"),
        ([0, 0.3, 0.5, 0.6, 0.3], True, "ssssss"), ([0, 0, 0.5, 0.2, 0], False, "ssssss"),
    ],
)  # fmt: skip
def test_a_bang_that_brings_a_state_to_its_bound_is_no_noise(
    speed: list[float], moved: bool, after: str
) -> None:
    """However little it gains: v' = u with v >= 0, which the arcs beside the bang may hold."""
    there = sampled(6, u=np.repeat([0.5, 0.5, -1, 0.5, 0.5, 0.5], PER_SEGMENT)[None, :])
    there.x = np.interp(there.times, [0, 2, 2.5, 3, 6], speed)[None, :]
    there.leg.state_bounds = interval(0.0, np.inf)
    there.functions = SimpleNamespace(rates=lambda t, x, u: u if moved else 0 * u)
    labels = np.repeat(kinds("sslsss"), PER_SEGMENT)
    d._absorb(there, 0, labels, np.repeat([0, 0, 1e-4, 0, 0, 0], PER_SEGMENT))
    assert text(labels[::PER_SEGMENT]) == after


# --- singular segments ------------------------------------------------------------------------------------


def singular(inside: list[float], gradient: list[float]) -> list[int]:
    """Segments by the share of their points at which the control is inside, and the largest switching function."""
    values = tuple(np.where(np.arange(10) < 10 * share, 0.0, 1.0)[None, :] for share in inside)
    there = sampled(len(inside))
    there.leg.u = SimpleNamespace(values=values)
    return d._singular_segments(
        there, 0, np.repeat(gradient, PER_SEGMENT) * np.tile([0.5, -1, 0.2, 0], len(inside))
    )


@pytest.mark.parametrize(
    ("inside", "gradient", "found"),
    [
        ([1, 1, 1, 0, 0], [0, 0, 0, 1, 1], [0, 1, 2]), ([0, 1, 0, 0, 0], [1, 0, 1, 1, 1], []),
        ([1, 0, 1, 1, 0], [0, 0, 0, 0, 0], [2, 3]), ([0.6, 0.6, 0.5, 0, 0], [0] * 5, [0, 1]),
        ([1, 1, 1, 1, 1], [0.019, 0.019, 0.021, 0.01, -0.01], [0, 1, 3, 4]), ([1, 0, 1, 0, 1], [0] * 5, []),
        ([1, 1, 1, 1, 1], [-0.021, 0.01, 0.01, 1, 1], [1, 2]), ([0, 0, 0, 1, 1], [0] * 5, [3, 4]),
    ],
)  # fmt: skip
def test_a_singular_arc_is_two_neighbours_with_a_small_switching_function(
    inside: list[float], gradient: list[float], found: list[int]
) -> None:
    assert singular(inside, gradient) == found


@pytest.mark.parametrize(("u", "found"), [(0.95, [0, 1]), (0.97, []), (-0.95, [0, 1]), (-0.97, [])])
def test_near_a_bound_is_a_share_of_the_range(u: float, found: list[int]) -> None:
    there = sampled(2)
    there.leg.u = SimpleNamespace(values=(np.full((1, 3), u),) * 2)
    assert d._singular_segments(there, 0, np.zeros(8)) == found


# --- labels of controls, paths and states -----------------------------------------------------------------

CART = cart()


def integrator(**bounds: Any) -> go.Problem:
    """x' = u, the integral of x: H is linear in u, and its switching function is lam."""
    model = go.Model("integrator")
    x, u = model.state("x"), model.control("u")
    model.ode({x: u})
    problem = go.Problem("integrator")
    leg = problem.phase("leg", model)
    leg.time(0.0, 8.0)
    problem.minimize(leg.integral(x))
    return problem


LINE = integrator()


def flight(u: Any, lam: Any, bounds: Any = (-1.0, 1.0), segments: int = 8, x: Any = None) -> PhaseSamples:
    return samples(
        LINE, x or (lambda t, k: [0.1 * t]), u, lam, weights=(0.0,), breaks=np.arange(segments + 1.0), degree=3,
        control_bounds=interval(*bounds),
    )  # fmt: skip


def test_a_linear_control_follows_the_sign_of_its_switching_function() -> None:
    found = d.detect(flight(lambda t, k: [-1 + 2 * (k > 3) + 0 * t], lambda t, k: [3.7 - t]))
    assert [piece[0] for piece in found.kinds] == [LOW, UP]
    assert found.times == pytest.approx((0.0, 3.7, 8.0), abs=1e-12)
    assert (found.n_controls, found.n_paths, found.regular) == (1, 0, (False, False))
    assert found.states.tolist() == [[FREE, FREE]]


def test_a_singular_arc_between_bangs_ends_between_samples() -> None:
    def lam(t: Array, k: int) -> Any:
        return [np.where(k < 2, 2 - t, np.where(k > 5, 6 - t, 0 * t))]

    found = d.detect(flight(lambda t, k: [(-1.0 if k < 2 else 1.0 if k > 5 else 0.3) + 0 * t], lam))
    assert [piece[0] for piece in found.kinds] == [LOW, SING, UP]
    assert found.times == pytest.approx((0.0, 2.0, 6.0, 8.0), abs=0.1)


def test_a_control_that_a_state_constraint_determines_lies_between_its_bounds_whatever_its_sign_is() -> None:
    held = [Determined(0, 1.0, 3.0), Determined(1, 5.0, 6.0)]  # the other one is of another control
    found = d.detect(
        flight(
            lambda t, k: [(0.3 if k in (1, 2) else -1.0 if k < 3 else 1.0) + 0 * t], lambda t, k: [3.0 - t]
        ),
        held,
    )
    assert [piece[0] for piece in found.kinds] == [LOW, SING, UP]
    assert found.times == pytest.approx((0.0, 1.0, 3.0, 8.0), abs=0.2)


@pytest.mark.parametrize(
    ("bounds", "affine"), [((-1, 1), True), ((-1, np.inf), False), ((-np.inf, 1), False)]
)
def test_bang_bang_needs_two_bounds(bounds: Any, affine: bool) -> None:
    assert b.affine_channels(flight(lambda t, k: [0 * t], lambda t, k: [t], bounds)).tolist() == [affine]


def test_curvature_tells_linear_from_convex() -> None:
    """H'' = 1 over a range of 20, in shares of H of 54: 400 / 54."""
    found = samples(CART, control_bounds=interval(-10.0, 10.0))
    assert b.curvature(found) == pytest.approx(400 / found.hamiltonian_scale)
    assert b.regular_channels(found).tolist() == [True] and b.affine_channels(found).tolist() == [False]
    concave = samples(CART, weights=(-0.5,), control_bounds=interval(-10.0, 10.0))
    assert b.regular_channels(concave).tolist() == [False] == b.affine_channels(concave).tolist()
    line = flight(lambda t, k: [0 * t], lambda t, k: [t])
    assert b.regular_channels(line).tolist() == [False] and b.affine_channels(line).tolist() == [True]


def test_the_switching_function_at_a_time_is_that_of_the_samples() -> None:
    found = samples(CART, lam=lambda t, k: [0 * t, 5 + t], paths=lambda t, k: [2 * t, 0 * t])
    t = np.array([0.1, 0.8])
    assert d.switching(found, t)[0] == pytest.approx(6 - 12 * t + 5 + t + 2 * t)
    line = flight(lambda t, k: [0 * t], lambda t, k: [3.7 - t])
    assert d.switching(line, np.ones(1)) == pytest.approx(np.array([[2.7]]))


@pytest.mark.parametrize(("back", "share", "jump"), [(0, 1.001, True), (0, 0.999, False), (1, 9.0, False)])
def test_from_bound_to_bound_within_so_many_segments_is_a_jump_of_a_convex_control(
    back: int, share: float, jump: bool
) -> None:
    """Between its bounds from the second segment of three on; the way back to the same bound is none."""
    ends = ((-5.0, -8.0), (5.0, 8.0)) if not back else ((-5.0, -8.0), (-5.0, -8.0))

    def u(t: Any, k: int) -> Any:
        return [20 * (t - 0.5) + 0.3 if k == 1 else ends[k // 2][0] + 0 * t]

    def lam(t: Any, k: int) -> Any:
        pull = 8.0 if k == 0 or (k == 2 and back) else -8.0
        return [0 * t, pull + 0 * t]

    found = samples(CART, u=u, lam=lam, control_bounds=interval(-5.0, 5.0), breaks=(0.0, 0.3, 0.7, 1.0))
    plain = d._nonlinear_labels(found, 0)
    inner = found.times[plain == FREE]
    assert set(found.segments[plain == FREE]) == {1}
    labels = d._nonlinear_labels(found, 0, share * (inner[-1] - inner[0]) / 0.4)
    between = found.u[0] > 0
    expected = np.where(between, UP, LOW)[found.segments == 1] if jump else [FREE] * inner.size
    assert labels[plain == FREE].tolist() == list(expected)
    assert labels[plain != FREE].tolist() == plain[plain != FREE].tolist()


def test_a_convex_control_is_at_a_bound_if_it_touches_and_is_pulled_there() -> None:
    """At 5, then at -5, its bounds; dH/du = a + lam_v is negative at the upper one, or positive at the lower one."""
    for lam, labels in ((-8.0, [UP, FREE]), (8.0, [FREE, LOW]), (0.0, [FREE, FREE])):
        found = samples(
            CART, u=lambda t, k: [5.0 - 10 * k + 0 * t], lam=lambda t, k, lam=lam: [0 * t, lam + 0 * t],
            control_bounds=interval(-5.0, 5.0),
        )  # fmt: skip
        rows = d._nonlinear_labels(found, 0)
        assert [set(rows[found.segments == k]) for k in (0, 1)] == [{label} for label in labels]
    neither = samples(CART, lam=lambda t, k: [0 * t, 0 * t], control_bounds=interval(-9.0, 9.0))
    assert set(d._nonlinear_labels(neither, 0)) == {FREE}


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("away", "label"), [(0.5, UP), (2.0, FREE)])
def test_a_convex_control_touches_a_bound_within_a_share_of_its_range(
    size: float, away: float, label: ArcKind
) -> None:
    """Whatever its unit; it is pulled to the upper one all along."""
    level = 5.0 * size - away * d.ACTIVE_LIMIT_TOLERANCE * 10.0 * size
    found = samples(
        CART, u=lambda t, k: [level + 0 * t], lam=lambda t, k: [0 * t, -9.0 * size + 0 * t],
        control_bounds=interval(-5.0 * size, 5.0 * size),
    )  # fmt: skip
    assert set(d._nonlinear_labels(found, 0)) == {label}


def test_mixed_paths_are_inequalities_on_convex_controls_alone() -> None:
    found = samples(CART)
    assert d._mixed_paths(found, np.array([True])).tolist() == [True, False]
    assert d._mixed_paths(found, np.array([False])).tolist() == [False, False]
    equal = samples(CART, path_bounds=interval([3.0, -50.0], [3.0, np.inf]))
    assert d._mixed_paths(equal, np.array([True])).tolist() == [False, False]


def test_a_mixed_path_needs_every_control_it_depends_on_to_be_convex() -> None:
    slopes = np.zeros((3, 2, 2))
    slopes[0, 0], slopes[1, :, 0], slopes[2, 1, 1] = (
        1.0,
        1.0,
        1.0,
    )  # on the first, on both, on the second at times
    there: Any = SimpleNamespace(
        functions=SimpleNamespace(path_control_jacobian=lambda *at: slopes), times=None, x=None, u=None,
        leg=SimpleNamespace(
            path_bounds=interval([-np.inf] * 3, [1.0] * 3), path_labels=("a", "b", "c"), composed_controls=()
        ),
    )  # fmt: skip
    assert d._mixed_paths(there, np.array([True, False])).tolist() == [True, False, False]
    assert d._mixed_paths(there, np.array([False, True])).tolist() == [False, False, True]
    assert d._mixed_paths(there, np.array([True, True])).tolist() == [True, True, True]


def test_path_labels_need_the_limit_and_its_multiplier() -> None:
    """v + a = 6 - 6 t - 6 t^2 from 6 to -6; at most 6 and at least -6, with multipliers of either sign."""

    def labels(mu: float, mixed: tuple[bool, bool] = (True, False)) -> list[Any]:
        found = samples(
            CART, path_bounds=interval([-6.0, -50.0], [6.0, 1.0]), paths=lambda t, k: [mu + 0 * t, mu + 0 * t]
        )
        return d._path_labels(found, np.array(mixed))

    assert [set(row) for row in (labels(1.0)[1], labels(1.0, (False, False))[0])] == [{FREE}, {FREE}]
    first = labels(1.0)[0]
    assert first[0] is UP and first[-1] is FREE
    last = labels(-1.0)[0]
    assert last[0] is FREE and last[-1] is LOW
    assert labels(1.0, (False, True))[1][-1] is UP and labels(-1.0, (False, True))[1][-1] is FREE
    assert d._path_labels(flight(lambda t, k: [0 * t], lambda t, k: [t]), np.zeros(0, dtype=bool)) == []


def held(x: Any, controls: str, bounds: Any = (-9.0, 1.0)) -> str:
    """Labels of the state of an integrator that is sampled on 8 segments, a letter to each segment for its control."""
    found = samples(
        LINE, x, lambda t, k: [0 * t], lambda t, k: [t], weights=(0.0,), breaks=np.arange(9.0), degree=3,
        state_bounds=interval(*bounds), control_bounds=interval(-1.0, 1.0),
    )  # fmt: skip
    rows = kinds(controls)[found.segments][None, :]
    (labels,) = d._state_labels(found, rows)
    starts = np.searchsorted(found.segments, np.arange(8)) + 3
    return text(labels[starts])


def plateau(height: float, first: int, last: int) -> Any:
    return lambda t, k: [height + 0 * t if first <= k <= last else 0.5 * height + 0.1 * t]


@pytest.mark.parametrize(
    ("height", "controls", "bounds", "labels"),
    [
        (1.0, "llssssuu", (-9.0, 1.0), "iiuuuuii"), (-1.0, "llssssuu", (-1.0, 9.0), "iillllii"),
        (1.0, "llllssuu", (-9.0, 1.0), "iiiiuuii"), (1.0, "llluuuuu", (-9.0, 1.0), "iiiiiiii"),
        (0.999, "llssssuu", (-9.0, 1.0), "iiiiiiii"), (1.0, "llssssuu", (-9.0, 1.2), "iiiiiiii"),
    ],
)  # fmt: skip
def test_a_state_is_held_on_its_bound_where_a_singular_control_could_move_it(
    height: float, controls: str, bounds: Any, labels: str
) -> None:
    assert held(plateau(height, 2, 5), controls, bounds) == labels


def test_short_gaps_of_a_held_state_are_closed_where_its_control_is_singular() -> None:
    def dented(t: Array, k: int) -> Any:
        return [1.0 + 0 * t if k in (2, 3, 5) else 0.99 + 0 * t]

    assert held(dented, "llssssuu") == "iiuuuuii"
    assert held(dented, "llssluuu") == "iiuuiiii"


def test_which_state_a_singular_control_commands() -> None:
    there: Any = SimpleNamespace(
        x=np.array([[3.0] * 5, [4.0] * 5]), u=np.array([[1.0] * 5, [2.0] * 5]), times=np.arange(5.0),
        control_scale=np.array([2.0, 4.0]),
        functions=SimpleNamespace(rates=lambda t, x, u: np.array([u[0] * (t == 2.0), u[1]])),
    )  # fmt: skip
    for first, second, found in (
        ("sssss", "lllll", ["00100", "00000"]),
        ("lllll", "sssss", ["00000", "11111"]),
        ("sssss", "llsss", ["00100", "00111"]),
        ("sslss", "lllll", ["00000", "00000"]),
    ):
        expected = [[c == "1" for c in row] for row in found]
        rows = np.array([kinds(first), kinds(second)])
        np.testing.assert_array_equal(d._commanded(there, rows), expected)


def test_a_held_state_ends_where_its_own_control_leaves_though_another_one_is_singular() -> None:
    """Two axes at their speed limits: just below its limit the second one is not held by the first torque."""
    times = np.repeat(np.arange(6.0), 4) + np.tile([0.0, 0.3, 0.7, 1.0], 6)
    segments = np.repeat(np.arange(6), 4)
    speeds = np.array(
        [np.where(np.isin(segments, (1, 2, 3, 4)), 1.0, 0.5), np.where(np.isin(segments, (2, 3)), 1.0, 0.99)]
    )
    found: Any = SimpleNamespace(
        x=speeds, u=0.5 * np.ones((2, times.size)), times=times, segments=segments,
        control_scale=np.array([2.0, 2.0]), state_scale=np.ones(2),
        leg=SimpleNamespace(
            states=SimpleNamespace(size=2), mesh=SimpleNamespace(segments=6), breaks=np.arange(7.0), path_labels=(),
            state_bounds=interval([-1.0, -1.0], [1.0, 1.0]),
            initial_bounds=interval([-np.inf] * 2, [np.inf] * 2), final_bounds=interval([-np.inf] * 2, [np.inf] * 2),
        ),
        functions=SimpleNamespace(rates=lambda t, x, u: u),
    )  # fmt: skip
    controls = np.array([kinds("lssssu")[segments], kinds("llssuu")[segments]])
    assert [text(row[::4]) for row in d._state_labels(found, controls)] == ["iuuuui", "iiuuii"]


# --- times ------------------------------------------------------------------------------------------------


def test_changes_lie_midway_or_at_the_zero_of_the_switching_function() -> None:
    line = flight(lambda t, k: [0 * t], lambda t, k: [(t - 2.3) * (t - 5.6)], segments=8)
    labels = choose(line.control_gradient[0] > 0, LOW, UP)
    assert d._change_times(line, [labels])[0] == pytest.approx([2.3, 5.6], abs=1e-12)
    j = np.flatnonzero(labels[1:] != labels[:-1])
    middles = 0.5 * (line.times[j] + line.times[j + 1])
    assert d._middles(line, labels) == pytest.approx(list(middles)) and len(middles) == 2
    labels[j[0] + 1 : j[1] + 1] = SING
    assert d._change_times(line, [labels])[0] == pytest.approx(list(middles))
    assert d._middles(line, np.full(line.times.size, LOW)) == []


def test_a_jump_at_a_boundary_is_a_change_there() -> None:
    line = flight(lambda t, k: [0 * t], lambda t, k: [1.0 - 2 * (k > 3) + 0 * t])
    labels = choose(line.control_gradient[0] > 0, LOW, UP)
    assert d._change_times(line, [labels])[0] == pytest.approx([4.0], abs=1e-12)


def test_a_root_lies_where_the_signs_differ_or_else_in_the_middle() -> None:
    def at(values: Callable[[Array], Array], left: float, right: float) -> float:
        return float(d.roots(values, np.array([left]), np.array([right]))[0])

    assert at(lambda t: t - 0.3, 0.0, 1.0) == pytest.approx(0.3, abs=1e-14)
    assert at(lambda t: 0.3 - t, 0.0, 1.0) == pytest.approx(0.3, abs=1e-14)
    assert at(lambda t: t + 1, 0.0, 1.0) == 0.5 and at(lambda t: -t - 1, 2.0, 4.0) == 3.0
    assert at(lambda t: t, 0.0, 1.0) == 0.5  # a zero at an end is no change of sign
    assert at(lambda t: t - 1e6 - 0.3, 1e6, 1e6 + 1) == pytest.approx(1e6 + 0.3, abs=2e-8)


def test_roots_are_found_all_at_once_however_bent_the_functions_are() -> None:
    wanted = np.array([0.2, 0.5, 0.7, 0.999, 1e-9, 0.4])

    def values(t: Array) -> Array:
        u = t - wanted
        return np.array([u[0], u[1] ** 3, np.tanh(1e3 * u[2]), np.expm1(40 * u[3]), u[4], np.sign(u[5])])

    found = d.crossings(values, np.zeros(6), np.ones(6))
    assert found == pytest.approx(wanted, abs=3e-14)
    assert d.crossings(values, np.ones(6), np.zeros(6)) == pytest.approx(wanted, abs=3e-14)


@pytest.mark.parametrize(
    ("function", "most"),
    [
        (lambda t: t - 0.3, 4), (lambda t: np.exp(20 * t) - 2, 20), (lambda t: np.tanh(1e3 * (t - 0.3)), 20),
        (lambda t: np.arctan(50 * (t - 0.7)), 20), (lambda t: t**19 - 1e-3, 20), (lambda t: np.log(t + 1e-6) + 3, 20),
        # Flat or upright at the zero: no interpolation helps.
        (lambda t: (t - 0.3) ** 3, 50), (lambda t: (t - 0.3) ** 9, 50), (lambda t: np.cbrt(t - 0.3), 50),
    ],
)  # fmt: skip
def test_a_crossing_takes_few_evaluations_and_hardly_ever_more_than_bisection(
    function: Any, most: int
) -> None:
    """Bisection needs 48 to the last digits of 1 s, and two at the ends."""
    seen = 0

    def counted(t: np.ndarray) -> np.ndarray:
        nonlocal seen
        seen += 1
        return np.asarray(function(t))

    found = d.crossings(counted, np.zeros(1), np.ones(1))
    assert seen <= most and function(found - 1e-12) * function(found + 1e-12) < 0


def test_labels_between_changes() -> None:
    labels = kinds("llluuusss")
    assert text(d._labels_at(labels, [1.0, 2.0], np.array([0.5, 1.5, 1.9, 2.5]))) == "luus"
    assert text(d._labels_at(kinds("lll"), [], np.array([0.5, 9.0]))) == "ll"
    assert text(d._labels_at(kinds("lus"), [1.0, 2.0], np.array([0.5, 1.5, 2.5]))) == "lus"


def test_limits_signs_and_choices() -> None:
    lower, upper = np.array([True, False, False, True]), np.array([False, True, False, True])
    assert text(d._at_limits(lower, upper)) == "luil"
    assert signs_of(kinds("liusr")).tolist() == [-1, 0, 1, 0, 0]
    assert choose(np.array([True, False]), UP, LOW).tolist() == [UP, LOW]


def test_the_structure_of_the_cart_has_all_rows() -> None:
    """A convex control within bounds, a mixed path at its limit late, a pure one, two states."""
    found = d.detect(
        samples(
            CART, paths=lambda t, k: [-1.0 + 0 * t, 0 * t], path_bounds=interval([-5.0, -50.0], [100.0, np.inf]),
            control_bounds=interval(-20.0, 20.0), breaks=np.linspace(0, 1, 9),
        )
    )  # fmt: skip
    assert found.regular == (True, True, False, False, False) and (found.n_controls, found.n_paths) == (1, 2)
    assert found.paths[0].tolist() == [FREE, LOW] and found.paths[1].tolist() == [FREE, FREE]
    crossing = (-1 + np.sqrt(1 + 4 * 11 / 6)) / 2  # 6 - 6 t - 6 t^2 = -5
    assert found.times[1] == pytest.approx(crossing, abs=0.02) and found.times[2] == 1.0


def test_no_arc_of_a_state_begins_where_another_value_is_given() -> None:
    """s' = u, -1 <= u, s <= 1, s(0) = 0, least integral of -w(t) s, w = exp((t - T) / 2): s = min(t, 1) is best.

    At the start w is 5e-5, so that the control looks singular there, and an arc on s = 1 would win over the optimum.
    """
    end, rate = 20.0, 0.5
    model = go.Model("late")
    s, w, u = model.state("s"), model.state("w"), model.control("u")
    model.ode({s: u, w: rate * w})
    problem = go.Problem("late")
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=end)
    leg.initial(s=0.0, w=np.exp(-rate * end))
    leg.bounds(u=(-1.0, 1.0), s=(-1.0, 1.0))
    problem.minimize(leg.integral(-w * s))
    # the integral of w is (1 - exp(-T / 2)) / (1 / 2); s is 1 - t too small in the first second
    short = np.exp(-rate * end) * (np.exp(rate) - 1 - rate) / rate**2
    best = short - (1 - np.exp(-rate * end)) / rate
    coarse = go.solve(problem, tol=None)
    state = d.structures_of(coarse)["leg"].states[0]
    assert state[0] is FREE and UP in state
    found, _ = optimise_switches(coarse)
    assert found.phase().x(0.0)[0] == 0.0
    assert found.objective >= best - 1e-9
