"""The benchmark of rendezvous between random boundary values: what it draws, what it calls a false alarm."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.validation.random_rendezvous import SAME, Outcome, draw, false_alarm


def test_what_is_drawn() -> None:
    """Positions of 20 to 45 m, turns of up to 150 degrees, the same ones for the same seed."""
    first, again, other = draw(3, 6), draw(3, 6), draw(5, 6)
    starts = []
    for problem in (*first, *again, *other):
        numbers = problem.phases["approach"].numbers
        assert np.all(numbers.initial.fixed) and np.all(numbers.final.fixed)
        start, sigma = numbers.initial.lower[-3:], numbers.final.lower[3:6]
        assert 20.0 <= np.linalg.norm(start) <= 45.0
        assert 4 * np.arctan(np.linalg.norm(sigma)) <= np.radians(150.0)
        starts.append(start)
    np.testing.assert_array_equal(starts[:6], starts[6:12])
    assert np.min(np.linalg.norm(np.subtract(starts[:6], starts[12:]), axis=1)) > 1e-3


@pytest.mark.parametrize(
    ("word", "others", "alarm"),
    [
        ("NOT ok", [("ok", 0.0)], True),
        ("NOT ok", [("minimum", 1.0)], True),
        ("NOT ok", [("minimum", -2 * SAME)], False),
        ("NOT ok", [("NOT ok", 0.0)], False),
        ("ok", [("ok", 0.0)], False),
    ],
)
def test_what_is_a_false_alarm(word: str, others: list[tuple[str, float]], alarm: bool) -> None:
    """What is not ok, and no worse than what another mesh certifies."""
    tried = [Outcome(0, "20x4", told, 30.0 + more, 1.0, ()) for told, more in others]
    assert false_alarm(Outcome(0, "20x3", word, 30.0, 1.0, ()), tried) is alarm
