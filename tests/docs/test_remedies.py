"""What to do when it does not solve: a section for every ending and every condition, and for nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest
from pages import doc

import gnc_opt as go

PAGE = doc("when_it_does_not_solve")


def sections(heading: str) -> list[str]:
    return re.findall(r"(?m)^### (.+)$", PAGE.section(heading))


@pytest.mark.parametrize(
    ("heading", "names"),
    [
        ("How a solve ends", [status.value for status in go.Status]),
        ("How a refinement ends", [status.value for status in go.RefinementStatus]),
        ("Conditions of the verdict", re.findall(r"(?m)^### (.+)$", doc("verdict").text)),
    ],
)
def test_every_ending_has_its_section(heading: str, names: Iterable[str]) -> None:
    """The headings of the verdict's own page are compared with the code elsewhere."""
    told = sections(heading)
    assert len(told) == len(set(told))
    assert set(told) == set(names)


def test_conditions_stand_in_the_order_of_the_verdict() -> None:
    """The page tells to begin with the first that fails."""
    order = re.findall(r"(?m)^### (.+)$", doc("verdict").text)
    assert sections("Conditions of the verdict")[:7] == order[:7]
