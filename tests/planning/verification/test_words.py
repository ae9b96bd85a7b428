"""What ok and minimum say: necessary conditions hold, and sufficient ones too."""

import itertools

import pytest

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
    assert verdict(PASS, PASS).headline == "every condition passes: a strict local optimum"
    found = verdict(PASS, UNTOLD).headline
    assert found == "ok: the necessary conditions hold, the sufficient ones are not confirmed"
    assert verdict(PASS, None).headline == verdict(PASS, UNTOLD).headline
    assert verdict(UNTOLD, PASS).headline == "inconclusive: stationarity"
    assert verdict(PASS, FAIL).headline == "NOT ok: second order fails"
