"""What ok and minimum say: necessary conditions hold, and sufficient ones too."""

import itertools

import pytest
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt import Condition, ConditionResult, Verdict

PASS, FAIL, UNTOLD = ConditionResult.PASS, ConditionResult.FAIL, ConditionResult.INCONCLUSIVE


def verdict(necessary: ConditionResult, sufficient: ConditionResult | None, not_checked: str = "") -> Verdict:
    conditions = [Condition("stationarity", necessary, 1e-7, 1e-5, "phase leg", "It must hold.")]
    if sufficient is not None:
        conditions.append(
            Condition("second order", sufficient, 1e-7, 1e-5, "phase leg", "It must hold.", True)
        )
    return Verdict("double integrator", tuple(conditions), not_checked)


@pytest.mark.parametrize(
    ("necessary", "sufficient"), list(itertools.product(ConditionResult, [*ConditionResult, None]))
)
def test_ok_and_minimum(necessary: ConditionResult, sufficient: ConditionResult | None) -> None:
    judged = verdict(necessary, sufficient)
    assert judged.ok == (necessary is PASS and sufficient is not FAIL)
    assert judged.minimum == (necessary is PASS and sufficient is PASS)
    assert not judged.minimum or judged.ok


def test_without_costates_neither_holds() -> None:
    judged = verdict(PASS, PASS, "no costates")
    assert not judged.ok and not judged.minimum
    assert judged.outcome == "not checked: no costates"


def test_headlines_say_which_of_the_three_it_is() -> None:
    assert verdict(PASS, PASS).headline == "every condition passes: a strict local minimum"
    assert (
        verdict(PASS, UNTOLD).headline
        == "ok: the necessary conditions hold, the sufficient ones are not confirmed"
    )
    assert verdict(PASS, None).headline == verdict(PASS, UNTOLD).headline
    assert verdict(UNTOLD, PASS).headline == "not checked: stationarity"
    assert verdict(PASS, FAIL).headline == "NOT ok"


@pytest.mark.parametrize(
    ("necessary", "sufficient"), [(PASS, PASS), (PASS, UNTOLD), (UNTOLD, PASS), (PASS, FAIL)]
)
def test_nothing_is_called_a_proof(necessary: ConditionResult, sufficient: ConditionResult) -> None:
    """Conditions are tested at samples, to a tolerance."""
    judged = verdict(necessary, sufficient)
    said = f"{judged.headline} {judged} {judged.explain()} {judged._repr_html_()} {' '.join(dir(judged))}".lower()
    assert "minimum" in said
    assert not any(word in said for word in ("proof", "prove", "guarantee", "certif"))


def test_smooth_solution_without_a_second_order_test_is_no_minimum() -> None:
    """The first order alone holds at maxima and saddles too."""
    model, _x, u = dynamics("integrator", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("least effort", model, 0.0, 1.0)
    leg.initial(x=0.0)
    leg.final(x=1.0)
    problem.minimize(leg.integral(u**2))
    judged = go.verify(go.solve(problem, mesh="3x4", tol=None))
    assert judged.ok and judged["second order"].sufficient
    assert judged.minimum == (judged["second order"].result is PASS)
