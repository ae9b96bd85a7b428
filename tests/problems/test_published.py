"""The tables of the published systems: two comparisons that are judged apart, data and values that belong together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from benchmarks.validation import rendezvous_minima
from benchmarks.validation.published.comparison import Row, Value, compare, known, printed
from benchmarks.validation.published.runner import SYSTEMS
from benchmarks.validation.rendezvous_minima import GlobalOutcome

WHY = "the definition in print is unclear"


def row(ours: Any, holds: bool | None = None, **data: Any) -> Row:
    (found,) = compare([{"quantity": "a", **data}], [Value("a", ours, holds)])
    return found


RIGHT = row(72.85, published="172.7", reason=WHY, independent=72.87, relative=0.01)
"""What the independent computation gives, and not what is printed."""


@pytest.mark.parametrize("sign", [-1, 1])
def test_numbers_are_met_from_both_sides(sign: int) -> None:
    two = {"independent": [1.0, 2.0], "relative": 0.01}
    assert row((1.0, 2.0 + sign * 0.0199), **two).passes
    assert not row((1.0, 2.0 + sign * 0.0201), **two).passes
    assert not row((1.0 + sign * 0.0101, 2.0), **two).passes
    assert row(sign * 0.09, independent=0, absolute=0.1).passes
    assert not row(sign * 0.11, independent=0, absolute=0.1).passes


def test_what_is_no_number_agrees_with_nothing() -> None:
    assert not row(np.nan, independent=1, absolute=1.0).passes
    assert not row(1.0, independent="inf", relative=0.01).passes
    assert not row(np.inf, independent=1, relative=0.01).passes
    assert row(np.inf, independent="inf", relative=0.01).passes
    assert not row(np.nan, at_most=1.0).passes
    assert not printed("1.0", np.nan).agrees


def test_limits_and_conditions() -> None:
    assert row(1.0, at_most=1.0).passes and not row(1.1, at_most=1.0).passes
    assert row(0.5, condition="< 1").passes and not row(1.5, condition="< 1").passes
    assert row(5.0, True, condition="ok").passes and not row(5.0, False, condition="ok").passes
    with pytest.raises(ValueError, match="whether 'ok' holds has to be computed"):
        row(5.0, condition="ok")


@pytest.mark.parametrize(
    ("text", "ours", "agrees"),
    [
        ("1.825", 1.8255, True),  # cut off
        ("0.06", 0.0613, True),  # rounded
        ("1.825", 1.8261, False),
        ("1.825", 1.8239, False),
        ("120", 149.4, False),
        ("-0.05, 0.05", (-0.0498, 0.0499), True),
        ("-0.05, 0.05", (-0.0498, 0.0390), False),
        ("about 16.1", 16.05, True),
        ("2e-4", 2.4e-4, True),
        ("2e-4", 3.1e-4, False),
    ],
)
def test_digits_in_print_decide_what_agrees(text: str, ours: float, agrees: bool) -> None:
    assert printed(text, ours).agrees is agrees
    with pytest.raises(ValueError, match="give a statement"):
        printed(text, (1.0, 2.0, 3.0))


def test_no_mark_contradicts_its_reason() -> None:
    assert RIGHT.differs and RIGHT.passes
    assert not row(1.0, published="1.0", independent=2, absolute=0.1).passes
    assert not row(2.0, published="1.0").passes
    assert not row(1.0, published="1.0", reason=WHY).passes
    assert not row(1.0, reason=WHY).passes
    assert row(1.0, published="1.0").passes
    assert row(2.0, published="1.0", reason=WHY).passes
    assert row(2.0, statement="< 1", reason=WHY).passes
    assert row((), statement="drawn", agrees=False, reason=WHY).passes
    assert not row(2.0, False, statement="never", condition="rare").passes


def test_data_of_every_system() -> None:
    """As many rows as compare with the publication and with an independent computation; a reason where one is due."""
    counts = {
        "rendezvous": (27, 10),
        "formation_flying": (19, 56),
        "reaction_wheels": (80, 150),
        "flexible_spacecraft": (31, 126),
        "tethered_formation": (17, 201),
    }
    assert set(SYSTEMS) == set(counts)
    for system, count in counts.items():
        rows = known(system)
        kinds = ({"published", "statement"}, {"independent", "at_most", "condition"})
        assert tuple(sum(bool(kind & set(row)) for row in rows) for kind in kinds) == count, system


def push(duration: float) -> go.Problem:
    """One metre from rest to rest with the least integral of u^2: 12 / duration^3."""
    cart, _x, _v, u = dynamics("cart", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("push", cart, initial=0.0, final=duration)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    problem.minimize(leg.integral(u**2, "effort"))
    return problem


def test_published_times_are_named_by_their_minima(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = go.solve(push(1.0), tol=None)

    def minimum(exact: float, *coarse: float) -> go.Minimum:
        return go.Minimum(solution, exact, 1, (0,), 1, coarse, True, True)

    minima = (
        minimum(25.787180768, 25.7892),
        minimum(26.0335257, 26.0365),
        minimum(26.1656895, 26.167, 26.1674),
    )
    outcome = GlobalOutcome(2, "printed", go.Multistart("rendezvous", minima, {}, 3, 3, 1))
    gpm, gpops = outcome.published
    assert (gpm.rank, gpm.ours) == (3, 26.1674) and (gpops.rank, gpops.ours) == (2, 26.0335257)
    assert outcome.agrees
    lacking = GlobalOutcome(2, "printed", go.Multistart("rendezvous", minima[:2], {}, 3, 3, 1))
    assert lacking.published[0].rank is None and not lacking.agrees
    assert GlobalOutcome(2, "exact", outcome.found).published == ()
    (line,) = (line for line in rendezvous_minima.published_lines([outcome]) if " GPM " in line)
    assert "exactly 26.16568950 s, slower by 0.3785 s, +1.47 %" in line  # 26.1674 is 1.47 % over the best
