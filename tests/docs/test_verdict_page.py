"""docs/verdict.md has a section for every condition that a verdict can contain, and for no other."""

import re

import casadi as ca
import pytest
from testing.models import dynamics, one_phase
from testing.pages import ROOT
from testing.wrong_solutions import bang_bang, energy

import gnc_opt as go


def rough() -> go.Solution:
    """A hop whose price is looked up, and whose control has a kink."""
    model, y, u = dynamics("hop", "y", "u", lambda y, u: {y: u - 0.1 * ca.fabs(y)})
    problem, leg = one_phase("hop", model, 0.0, 1.0)
    leg.initial(y=0.0)
    leg.final(y=1.0)
    problem.minimize(leg.integral(u**2 + go.table([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 4.0, 9.0])(y)))
    return go.solve(problem, tol=None)


@pytest.mark.filterwarnings("ignore::gnc_opt.ProblemWarning")
def test_every_condition_has_its_section_and_every_section_its_condition() -> None:
    page = (ROOT / "docs" / "verdict.md").read_text(encoding="utf-8")
    headings = re.findall(r"^### (.+)$", page, re.MULTILINE)
    judged = {c.name for solution in (energy(), bang_bang(), rough()) for c in go.verify(solution).conditions}
    assert len(set(headings)) == len(headings)
    assert set(headings) == judged
