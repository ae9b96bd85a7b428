"""Results that are kept: one per set of values, however these are given."""

import pytest

from problems.kept import kept


def test_a_call_is_known_by_its_values() -> None:
    made: list[tuple[int, int, int]] = []

    @kept
    def taken(a: int, b: int = 2, *, c: int = 3) -> tuple[int, int, int]:
        made.append((a, b, c))
        return made[-1]

    first = taken(1)
    assert taken(1, 2) is taken(b=2, a=1) is taken(1, c=3) is first
    assert taken(1, 3) == (1, 3, 3) and taken(1, c=2) == (1, 2, 2) and taken(2) == (2, 2, 3)
    assert made == [(1, 2, 3), (1, 3, 3), (1, 2, 2), (2, 2, 3)]
    with pytest.raises(TypeError, match="d"):
        taken(1, d=4)
