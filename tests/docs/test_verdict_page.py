"""docs/verdict.md has a section for every condition that a verdict can contain, and for no other."""

import re

import gnc_opt as go
from tests.docs.pages import ROOT
from tests.verify.wrong import bang_bang, energy


def test_every_condition_has_its_section_and_every_section_its_condition() -> None:
    page = (ROOT / "docs" / "verdict.md").read_text(encoding="utf-8")
    headings = re.findall(r"^### (.+)$", page, re.MULTILINE)
    judged = {c.name for solution in (energy(), bang_bang()) for c in go.verify(solution).conditions}
    assert len(set(headings)) == len(headings)
    assert set(headings) == judged
