"""Logs, campaigns, batches and dispersions from numbers given by hand."""

from __future__ import annotations

import math
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from testing.internals import LoggedSignal, SuccessCriteria, estimate_pass_rate, read_success_criteria

from gnc_opt.errors import ArgumentError, GncOptError, UnknownNameError
from gnc_opt.model import Layout, Variable
from gnc_opt.simulation import Campaign, Outcome, Run, RunStatus
from gnc_opt.simulation.campaign_performance_measures import rank_dispersions
from gnc_opt.simulation.confidence_intervals import estimate_percentile

NAN, INF = math.nan, math.inf

TIMES = np.array([2.0, 3.0, 5.0])
VALUES = np.array([[1.0, 3.0, 7.0], [0.0, -1.0, 1.0]])


def logged(held):
    return LoggedSignal("s", "m", TIMES, VALUES, held, ("s[0]", "s[1]"))


LAYOUTS = {
    "state": Layout("state", (Variable("q", 2, "m"), Variable("a", 3), Variable("n"))),
    "measured": Layout("state", (Variable("q", 2, "m"), Variable("a", 3))),
    "command": Layout("command", (Variable("f", 2, "N"), Variable("g"))),
    "applied": Layout("control", (Variable("u", 2, "N m"),)),
    "memory": Layout("memory", (Variable("z"),)),
    "error": Layout("error", (Variable("q", 2, "m"), Variable("a", 3, "rad"), Variable("n"))),
    "parameter": Layout("parameter", (Variable("plant.m"), Variable("b.k", 2))),
}


def run_by_hand(**changes):
    steps = np.arange(4.0)
    fields = {
        "times": 10.0 + 2.0 * steps, "states": np.vstack([steps, -steps, np.zeros((3, 4)), 5 + 0 * steps]),
        "measured": np.vstack([steps[:3], 2 * steps[:3], np.zeros((3, 3))]),
        "commands": np.vstack([steps[:3], 3 * steps[:3], 4 * steps[:3]]),
        "applied": np.vstack([steps[:3], 5 * steps[:3]]), "memory": 7 * steps[None, :],
        "reference": np.zeros((5, 4)),
        "errors": np.vstack([3 * steps, 4 * steps, np.zeros((3, 4)), NAN * steps]),
        "parameters": np.array([2.0, 0.1, 0.2]), "effort": np.array([3.0, 4.0]),
        "energy": np.array([5.0, 6.0]), "saturation": np.array([0.6, 0.8, 2.0]),
        "variation": np.array([7.0, 8.0, 9.0]), "integration_error": 2e-10, "outcome": Outcome(RunStatus.OK),
        "seed": "5", "layouts": LAYOUTS,
    }  # fmt: skip
    return Run(**(fields | changes))


def test_signals_of_a_run_by_name():
    run = run_by_hand()
    assert run.state("n").values.tolist() == [[5, 5, 5, 5]] and run.state("q")(13.0).tolist() == [1.5, -1.5]
    assert run.measurement("q")(13.0).tolist() == [1, 2] and run.command("g")(15.9).tolist() == [8]
    assert run.control("u")(99.0).tolist() == [2, 10] and run.controller_state("z")(13.0).tolist() == [10.5]
    assert run.error("q")(13.0).tolist() == [4.5, 6.0] and run.parameter("b.k").tolist() == [0.1, 0.2]
    assert run.command("f").times.tolist() == [10, 12, 14] and run.state("q").times.size == 4
    assert (run.state("q").labels, run.state("q").unit) == (("q[0]", "q[1]"), "m")


def test_metrics_of_a_run_by_name():
    run = run_by_hand()
    assert run.miss("q") == 15.0 and run.miss("q", [3.0, 1.0]) == 4.0 and run.miss("n", 4.0) == 1.0
    assert run.settling_time("q", 5.0) == INF and run.settling_time("q", 15.0) == 0.0
    assert run.settling_time("q", 1.5, [3.0, -3.0]) == 4.0
    assert run.control_effort("u").tolist() == [3, 4] and run.control_energy("u").tolist() == [5, 6]
    assert run.delta_v("u", 2.0) == 3.5 and run.total_variation("f").tolist() == [7, 8]
    assert run.saturation_time("g").tolist() == [2.0] and run.attitude_error("a") == 0.0
    with pytest.raises(ArgumentError, match="has no reference"):
        run_by_hand(errors=None, reference=None).miss("q")


def test_a_run_in_words():
    lines = str(run_by_hand()).splitlines()
    assert lines == [
        "run of 6 s in 3 control steps: ok",
        "  final errors  q 15 m, a 0 rad, n nan",
        "  effort        u 5 N m s",
        "  saturated     f 1 s, g 2 s",
        "  integration   error about 2.0e-10, seed 5",
    ]
    assert len(str(run_by_hand(errors=None, reference=None)).splitlines()) == 4
    pushed = LAYOUTS | {"applied": Layout("control", (Variable("u", 2, "m/s^2"),))}
    assert "effort        u 5 m/s\n" in str(run_by_hand(layouts=pushed))


@pytest.mark.parametrize(
    ("outcome", "text"),
    [
        (Outcome(RunStatus.OK), "ok"),
        (Outcome(RunStatus.CONTROLLER_ALARM, "guard", 1.5), "controller_alarm: guard at 1.5 s"),
        (Outcome(RunStatus.LOST, "died"), "lost: died"),
    ],
)
def test_outcomes_in_words_and_on_their_way(outcome, text):
    assert str(outcome) == text and pickle.loads(pickle.dumps(outcome)) == outcome
    assert outcome == Outcome(outcome.status, outcome.what, outcome.time * 1.0)
    assert outcome.ok is (outcome.status is RunStatus.OK)


OUTCOMES = (
    Outcome(RunStatus.OK), Outcome(RunStatus.CONTROLLER_ALARM, "guard", 1.0), Outcome(RunStatus.OK),
    Outcome(RunStatus.LOST)
)  # fmt: skip


def campaign_by_hand(**changes):
    """Four runs, the last one lost; errors of q of length 5, 1, 2."""
    fields = {
        "seed": 3, "asked": 4, "indices": np.array([0, 1, 4, 5]), "parameters": np.arange(12.0).reshape(3, 4),
        "states": np.column_stack([np.arange(6.0), 10 + np.arange(6.0), np.zeros(6), np.full(6, NAN)]),
        "errors": np.array([[3, 0.6, 2, NAN], [4, 0.8, 0, NAN], *[[0] * 4] * 3, [NAN] * 4]),
        "target": np.array([0.0, 0.0, 0.0, 0.0, 0.0, NAN]),
        "effort": np.array([[1, 2, 3, NAN], [10, 20, 30, NAN]]),
        "energy": np.array([[4, 5, 6, NAN], [40, 50, 60, NAN]]),
        "saturation_time": np.array([[0.1, 0.5, 0.2, NAN], [0.4, 0.2, 0.3, NAN], [0, 0, 0, NAN]]),
        "variation": np.array([[1, 1, 2, NAN], [3, 4, 5, NAN], [7, 7, 7, NAN]]),
        "integration_error": np.zeros(4), "outcomes": OUTCOMES, "span": (0.0, 1.0),
        "limits": {"q": 2.0, "effort(u)": 30.0}, "measured": {"own": np.array([1.0, 2.0, 3.0, NAN])},
        "interrupted": False, "layouts": LAYOUTS,
    }  # fmt: skip
    return Campaign(**(fields | changes))


@pytest.mark.parametrize(
    ("name", "values", "unit"),
    [
        ("q", [5, 1, 2], "m"), ("own", [1, 2, 3], ""), ("effort(u)", [11, 22, 33], "N m s"),
        ("energy(u)", [44, 55, 66], "(N m)^2 s"), ("saturation(f)", [0.4, 0.5, 0.3], "s"),
        ("variation(f)", [4, 5, 7], "N"), ("variation(g)", [7, 7, 7], ""), ("saturation(g)", [0, 0, 0], "s"),
        ("angle(a)", [4 * np.arctan(np.sqrt(29)), 4 * np.arctan(np.sqrt(509)), 0.0], "rad"),
    ],
)  # fmt: skip
def test_measures_and_their_units(name, values, unit):
    """The angle to a target of zero is four arc tangents of the parameters' length, less a turn beyond half of one."""
    campaign = campaign_by_hand()
    found = campaign.measure(name)
    if name == "angle(a)":
        values = [min(v, 2 * np.pi - v) for v in values]
    assert found[:3] == pytest.approx(values, rel=1e-12) and np.isnan(found[3])
    assert campaign.unit(name) == unit and campaign.measure(name) is found


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("angle(q)", r"2 component\(s\)"), ("n", "no reference for 'n'"), ("effort(f)", "no measure"),
        ("variation(u)", "no measure"), ("effort(u", "no measure"), ("angle(x)", "no measure"), (3, "no measure"),
        ("q)", "no measure"), ("anle(a)", r"did you mean 'angle\(a\)'"), ("error(q)", "no measure"),
    ],
)  # fmt: skip
def test_measures_that_are_none(name, message):
    with pytest.raises((ArgumentError, UnknownNameError), match=message):
        campaign_by_hand().measure(name)


def test_what_passed_is_ok_and_within_its_limits():
    campaign = campaign_by_hand()
    assert campaign.ok.tolist() == [True, False, True, False]
    assert campaign.passed("q").tolist() == [False, False, True, False]
    assert campaign.passed("effort(u)").tolist() == [True, False, False, False]
    assert campaign.passed().tolist() == [False] * 4 and campaign.ok.tolist() == [True, False, True, False]
    assert (campaign.pass_rate("q").passed, campaign.pass_rate("q").runs) == (1, 4)
    with pytest.raises(UnknownNameError, match="no limit 'own'"):
        campaign.passed("own")


def test_statistics_of_a_campaign():
    campaign = campaign_by_hand()
    assert campaign.percentile("own", 0.5).value == 2.0 and campaign.percentile("own", 0.9).value == INF
    assert campaign.maximum("own") == INF and campaign.worst("q", 3) == [5, 0, 4]
    assert campaign_by_hand(measured={"own": np.arange(4.0)}).maximum("own") == 3.0
    assert len(campaign_by_hand(indices=np.arange(4)).worst("q")) == 4
    assert campaign.status_counts == {RunStatus.OK: 2, RunStatus.CONTROLLER_ALARM: 1, RunStatus.LOST: 1}
    assert list(campaign.failures) == [1, 5] and campaign.failures[1].what == "guard"
    none = campaign_by_hand(outcomes=(), limits={})
    assert str(none) == "campaign of 0 runs, seed 3: none has ended"
    for act in (none.pass_rate, lambda: none.percentile("q", 0.5), lambda: none.maximum("q")):
        with pytest.raises(GncOptError, match="no run of the campaign has ended"):
            act()


def test_the_goal_is_the_reference_at_the_end_unless_a_target_is_given():
    flight = SimpleNamespace(
        states=LAYOUTS["state"], followed=LAYOUTS["measured"], reference=np.arange(10.0).reshape(5, 2)
    )
    assert SuccessCriteria().read_target_states(flight)[:5].tolist() == [1, 3, 5, 7, 9] and np.isnan(
        SuccessCriteria().read_target_states(flight)[5]
    )
    assert SuccessCriteria({"n": 2.0, "q": 8.0}).read_target_states(flight).tolist() == [8, 8, 5, 7, 9, 2]
    flight.reference = None
    assert np.isnan(SuccessCriteria({"n": 2.0}).read_target_states(flight)).tolist() == [True] * 5 + [False]
    with pytest.raises(ArgumentError, match="the target of 'q'"):
        SuccessCriteria({"q": [1.0, 2.0, 3.0]}).read_target_states(flight)


@pytest.mark.parametrize("kind", ["target", "limits", "measures"])
def test_criteria_that_are_no_mappings_are_refused(kind):
    assert read_success_criteria(None, None) == SuccessCriteria()
    with pytest.raises(ArgumentError, match=f"the {kind} of runs must be of type Mapping, not ndarray"):
        read_success_criteria(**{"target": None, "measures": None, kind: np.zeros(2)})


def test_criteria_are_checked_and_applied():
    campaign = campaign_by_hand(limits={}, measured={})
    measures = {"twice": lambda c: 2 * c.measure("q"), "sure": lambda c: c.limits["q"] + np.zeros(len(c))}
    applied = SuccessCriteria(limits={"q": 0.0, "twice": 10}, measures=measures).apply_success_criteria(
        campaign
    )
    assert applied.limits == {"q": 0.0, "twice": 10.0} and applied.measure("twice")[:3].tolist() == [10, 2, 4]
    assert applied.measure("sure").tolist() == [0.0] * 4  # measures of one's own may look at the limits
    SuccessCriteria(limits={"q": 1.0, "own": 1.0}, measures={"own": len}).check_performance_limits(campaign)
    for wrong, message in (
        (SuccessCriteria(limits={"qq": 1.0}), "no measure 'qq'"),
        (SuccessCriteria(limits={"q": -1.0}), "limit of 'q'"),
        (SuccessCriteria(measures={"own": 3.0}), "'own' is no function"),
    ):
        with pytest.raises((ArgumentError, UnknownNameError), match=message):
            wrong.check_performance_limits(campaign)
    with pytest.raises(ArgumentError, match=r"\(4,\)"):
        SuccessCriteria(measures={"own": lambda c: np.zeros(3)}).apply_success_criteria(campaign)


@pytest.mark.parametrize(
    ("rate", "text"),
    [((1, 2), "50.0 %"), ((1, 100), "1.0 %"), ((1, 1001), "0.100 %"), ((1, 10**7), "0.0000 %")],
)
def test_small_shares_have_digits(rate, text):
    assert str(estimate_pass_rate(*rate)).split(" (")[0] == text


def test_rank_correlations_of_dispersions():
    """The measure grows with k[0], with deviations of k[1] of either sign, and not with m; k[2] is constant."""
    rng = np.random.default_rng(1)
    k, noise = rng.normal(size=(2, 60)), rng.normal(size=60)
    layout = Layout("parameter", (Variable("plant.m"), Variable("b.k", 3)))
    runs = SimpleNamespace(parameters=np.vstack([noise, k, np.ones(60)]), layouts={"parameter": layout})
    first, second, *_ = rank_dispersions(runs, np.exp(k[0]))
    assert first[:2] == ("b.k[0]", pytest.approx(1.0)) and abs(second[1]) < 0.4
    even = rank_dispersions(runs, np.abs(k[1] - np.median(k[1])) + 0.1 * noise)
    distance = np.abs(k[1] - np.median(k[1]))
    expected = scipy.stats.spearmanr(distance, distance + 0.1 * noise).statistic
    assert even[0][:2] == ("|b.k[1]|", pytest.approx(expected)) and len(even) == 3
    lost = np.where(k[0] > 1.0, NAN, k[0])  # without a value: the worst
    together = np.where(k[0] > 1.0, 9.0, k[0])
    assert rank_dispersions(runs, lost)[0][1] == pytest.approx(
        scipy.stats.spearmanr(together, k[0]).statistic
    )
    assert rank_dispersions(runs, np.ones(60)) == []


@pytest.mark.parametrize(("level", "n"), [(0.5, 6), (0.9, 36), (0.95, 72), (0.99, 368)])
def test_least_number_of_runs_that_bounds_a_percentile(level, n):
    """The numbers that campaigns print for runs that are too few."""
    assert math.isinf(estimate_percentile(np.arange(n - 1.0), level).high)
    assert estimate_percentile(np.arange(float(n)), level).high == n - 1
    assert math.isinf(estimate_percentile(np.arange(n - 1.0), 1 - level).low)
    assert estimate_percentile(np.arange(float(n)), 1 - level).low == 0.0  # the smallest value by symmetry
