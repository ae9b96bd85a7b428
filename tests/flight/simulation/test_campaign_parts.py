"""Logs, campaigns, batches and dispersions from numbers given by hand."""

from __future__ import annotations

import math
import pickle
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from testing.loops import double_integrator, feedback

from gnc_opt.errors import ArgumentError, GncOptError, UnknownNameError, in_words
from gnc_opt.model import Layout, Variable
from gnc_opt.simulation import (
    Campaign,
    Choice,
    ClosedLoop,
    Normal,
    Outcome,
    RandomDirection,
    RandomRotation,
    Run,
    RunStatus,
    Uniform,
    UniformInBall,
)
from gnc_opt.simulation.campaign_batch import (
    BATCHES,
    MOST_PER_BATCH,
    CampaignTask,
    Flown,
    batches,
    flown_parts,
    gathered,
    halves,
)
from gnc_opt.simulation.confidence_intervals import pass_rate, percentile, share_below_maximum
from gnc_opt.simulation.monte_carlo import (
    Criteria,
    _refuse_total_loss,
    _shared,
    _tally,
    _with_parameters,
    read_criteria,
)
from gnc_opt.simulation.run import Logged, rotation_angle, settling_time
from gnc_opt.spacecraft import quaternion_product
from gnc_opt.workers import Done, WorkerDied

NAN, INF = math.nan, math.inf


# --- logged signals ---------------------------------------------------------------------------------------

TIMES = np.array([2.0, 3.0, 5.0])
VALUES = np.array([[1.0, 3.0, 7.0], [0.0, -1.0, 1.0]])


def logged(held):
    return Logged("s", "m", TIMES, VALUES, held, ("s[0]", "s[1]"))


def test_a_state_is_linear_between_its_samples():
    signal = logged(False)
    assert signal(2.5).tolist() == [2.0, -0.5] and signal(5.0).tolist() == [7.0, 1.0]
    assert signal([2.0, 4.0]).tolist() == [[1.0, 5.0], [0.0, 0.0]]
    assert signal(5.0 + 1e-12).tolist() == [7.0, 1.0]
    for t in (1.999999, 5.0001, [3.0, 6.0], NAN):
        with pytest.raises(ArgumentError, match="'s' is logged from 2 s to 5 s"):
            signal(t)


def test_a_command_is_held_to_the_next_one_and_after_the_last():
    signal = logged(True)
    assert signal([2.0, 2.999, 3.0, 4.9, 5.0, 99.0]).tolist()[0] == [1, 1, 3, 3, 7, 7]
    assert signal(3.0 - 1e-10).tolist() == [3.0, -1.0]  # rounding before a step is that step
    with pytest.raises(ArgumentError, match="logged from 2 s"):
        signal(1.9)


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
        "times": 10.0 + 2.0 * steps,
        "states": np.vstack([steps, -steps, np.zeros((3, 4)), 5 + 0 * steps]),
        "measured": np.vstack([steps[:3], 2 * steps[:3], np.zeros((3, 3))]),
        "commands": np.vstack([steps[:3], 3 * steps[:3], 4 * steps[:3]]),
        "applied": np.vstack([steps[:3], 5 * steps[:3]]),
        "memory": 7 * steps[None, :],
        "reference": np.zeros((5, 4)),
        "errors": np.vstack([3 * steps, 4 * steps, np.zeros((3, 4)), NAN * steps]),
        "parameters": np.array([2.0, 0.1, 0.2]),
        "effort": np.array([3.0, 4.0]),
        "energy": np.array([5.0, 6.0]),
        "saturation": np.array([0.6, 0.8, 2.0]),
        "variation": np.array([7.0, 8.0, 9.0]),
        "integration_error": 2e-10,
        "outcome": Outcome(RunStatus.OK),
        "seed": "5",
        "layouts": LAYOUTS,
    }
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
    with pytest.raises(ArgumentError, match="follows no reference"):
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


@pytest.mark.parametrize(
    ("outcome", "text"),
    [
        (Outcome(RunStatus.OK), "ok"),
        (Outcome(RunStatus.CONTROLLER_ALARM, "guard", 1.5), "alarm: guard at 1.5 s"),
        (Outcome(RunStatus.LOST, "died"), "lost: died"),
    ],
)
def test_outcomes_in_words_and_on_their_way(outcome, text):
    assert str(outcome) == text and pickle.loads(pickle.dumps(outcome)) == outcome
    assert outcome == Outcome(outcome.status, outcome.what, outcome.time * 1.0)
    flags = (outcome.ok, outcome.diverged, outcome.not_finite)
    assert flags == (outcome.status is RunStatus.OK, False, False)


def test_outcomes_that_left_the_scales():
    assert Outcome(RunStatus.DIVERGED).diverged and not Outcome(RunStatus.DIVERGED).not_finite
    assert Outcome(RunStatus.NOT_FINITE).not_finite and not Outcome(RunStatus.NOT_FINITE).ok


# --- campaigns --------------------------------------------------------------------------------------------

OUTCOMES = (
    Outcome(RunStatus.OK), Outcome(RunStatus.CONTROLLER_ALARM, "guard", 1.0), Outcome(RunStatus.OK),
    Outcome(RunStatus.LOST)
)  # fmt: skip


def campaign_by_hand(**changes):
    """Four runs, the last one lost; errors of q of length 5, 1, 2."""
    fields = {
        "seed": 3,
        "asked": 4,
        "indices": np.array([0, 1, 4, 5]),
        "parameters": np.arange(12.0).reshape(3, 4),
        "states": np.column_stack([np.arange(6.0), 10 + np.arange(6.0), np.zeros(6), np.full(6, NAN)]),
        "errors": np.array([[3, 0.6, 2, NAN], [4, 0.8, 0, NAN], *[[0] * 4] * 3, [NAN] * 4]),
        "target": np.array([0.0, 0.0, 0.0, 0.0, 0.0, NAN]),
        "effort": np.array([[1, 2, 3, NAN], [10, 20, 30, NAN]]),
        "energy": np.array([[4, 5, 6, NAN], [40, 50, 60, NAN]]),
        "saturation_time": np.array([[0.1, 0.5, 0.2, NAN], [0.4, 0.2, 0.3, NAN], [0, 0, 0, NAN]]),
        "variation": np.array([[1, 1, 2, NAN], [3, 4, 5, NAN], [7, 7, 7, NAN]]),
        "integration_error": np.zeros(4),
        "outcomes": OUTCOMES,
        "span": (0.0, 1.0),
        "limits": {"q": 2.0, "effort(u)": 30.0},
        "measured": {"own": np.array([1.0, 2.0, 3.0, NAN])},
        "interrupted": False,
        "layouts": LAYOUTS,
    }
    return Campaign(**(fields | changes))


def test_values_by_name():
    campaign = campaign_by_hand()
    assert len(campaign) == 4 and campaign.parameter("b.k")[:, 0].tolist() == [4, 8]
    assert campaign.state("q")[:, 1].tolist() == [10, 11] and campaign.error("q")[:, 0].tolist() == [3, 4]


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


def test_names_of_all_measures():
    assert campaign_by_hand().measures == (
        "q", "a", "own", "effort(u)", "energy(u)", "saturation(f)", "saturation(g)", "variation(f)", "variation(g)",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("angle(q)", r"2 component\(s\)"), ("n", "no reference of 'n'"), ("effort(f)", "no measure"),
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
    assert campaign.with_limits(q=5.0).passed().tolist() == [True, False, True, False]
    with pytest.raises(UnknownNameError, match="no limit 'own'"):
        campaign.passed("own")
    with pytest.raises(UnknownNameError, match="no measure"):
        campaign.with_limits(qq=1.0)


def test_statistics_of_a_campaign():
    campaign = campaign_by_hand()
    assert campaign.percentile("own", 0.5).value == 2.0 and campaign.percentile("own", 0.9).value == INF
    assert campaign.maximum("own") == INF and campaign.worst("q", 3) == [5, 0, 4]
    assert campaign_by_hand(measured={"own": np.arange(4.0)}).maximum("own") == 3.0
    assert len(campaign_by_hand(indices=np.arange(4)).worst("q")) == 4
    assert campaign.counts == {RunStatus.OK: 2, RunStatus.CONTROLLER_ALARM: 1, RunStatus.LOST: 1}
    assert list(campaign.failures) == [1, 5] and campaign.failures[1].what == "guard"
    none = campaign_by_hand(outcomes=(), limits={})
    for act in (none.pass_rate, lambda: none.percentile("q", 0.5), lambda: none.maximum("q")):
        with pytest.raises(GncOptError, match="no run of the campaign has ended"):
            act()


def test_only_runs_that_are_there_are_flown_again():
    flown = []
    flight = SimpleNamespace(run=lambda P, seed: flown.append((P.tolist(), seed)))
    campaign = campaign_by_hand(flight=flight)
    campaign.rerun(4)
    assert flown == [([2, 6, 10], [3, 4])]
    with pytest.raises(ArgumentError, match="no run 2: its 4 runs"):
        campaign.rerun(2)
    with pytest.raises(GncOptError, match="cannot fly"):
        campaign_by_hand().rerun(4)


# --- criteria ---------------------------------------------------------------------------------------------


def test_the_goal_is_the_reference_at_the_end_unless_a_target_is_given():
    flight = SimpleNamespace(
        states=LAYOUTS["state"], followed=LAYOUTS["measured"], reference=np.arange(10.0).reshape(5, 2)
    )
    assert Criteria().goal(flight)[:5].tolist() == [1, 3, 5, 7, 9] and np.isnan(Criteria().goal(flight)[5])
    assert Criteria({"n": 2.0, "q": 8.0}).goal(flight).tolist() == [8, 8, 5, 7, 9, 2]
    flight.reference = None
    assert np.isnan(Criteria({"n": 2.0}).goal(flight)).tolist() == [True] * 5 + [False]
    with pytest.raises(ArgumentError, match="the target of 'q'"):
        Criteria({"q": [1.0, 2.0, 3.0]}).goal(flight)


@pytest.mark.parametrize("kind", ["target", "limits", "judge"])
def test_criteria_that_are_no_mappings_are_refused(kind):
    assert read_criteria(None, None) == Criteria()
    with pytest.raises(ArgumentError, match=f"the {kind} of runs is a ndarray where a Mapping is needed"):
        read_criteria(**{"target": None, "judge": None, kind: np.zeros(2)})


def test_criteria_are_checked_and_applied():
    campaign = campaign_by_hand(limits={}, measured={})
    judge = {"twice": lambda c: 2 * c.measure("q"), "sure": lambda c: c.limits["q"] + np.zeros(len(c))}
    applied = Criteria(limits={"q": 0.0, "twice": 10}, judge=judge).applied(campaign)
    assert applied.limits == {"q": 0.0, "twice": 10.0} and applied.measure("twice")[:3].tolist() == [10, 2, 4]
    assert applied.measure("sure").tolist() == [0.0] * 4  # measures of one's own may look at the limits
    Criteria(limits={"q": 1.0, "own": 1.0}, judge={"own": len}).check(campaign)
    for wrong, message in (
        (Criteria(limits={"qq": 1.0}), "no measure 'qq'"),
        (Criteria(limits={"q": -1.0}), "limit of 'q'"),
        (Criteria(judge={"own": 3.0}), "'own' is no function"),
    ):
        with pytest.raises((ArgumentError, UnknownNameError), match=message):
            wrong.check(campaign)
    with pytest.raises(ArgumentError, match=r"\(4,\)"):
        Criteria(judge={"own": lambda c: np.zeros(3)}).applied(campaign)


# --- batches ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("runs", "size"), [(1, 1), (BATCHES, 1), (2 * BATCHES - 1, 1), (3 * BATCHES, 3), (10**5, MOST_PER_BATCH)]
)
def test_batches_hold_every_run_once(runs, size):
    cut = batches(runs)
    assert [i for batch in cut for i in batch] == list(range(runs))
    assert {len(batch) for batch in cut[:-1]} <= {size} and len(cut[-1]) <= size


def test_halves():
    assert halves(range(3, 8)) == (range(3, 5), range(5, 8)) and halves(range(3, 4)) == ()
    assert halves(range(3, 5)) == (range(3, 4), range(4, 5))


def test_errors_in_words_and_parts_of_a_batch():
    assert in_words(ValueError("out of\n  luck")) == "ValueError: out of luck"
    assert in_words(ValueError("x" * 300)) == "ValueError: " + "x" * 200
    flown = [Flown(range(2), None, None)]
    assert flown_parts(Done(range(2), flown)) is flown
    (died,), (raised,) = (
        flown_parts(Done(range(2), error=e)) for e in (WorkerDied("died"), ValueError("no"))
    )
    assert (died.batch, died.mishap, died.died) == (range(2), "died", True)
    assert (raised.mishap, raised.died, raised.ending) == ("ValueError: no", False, None)
    assert not flown[0].died and flown[0].mishap == ""


def ending(*oks):
    return SimpleNamespace(
        outcomes=[Outcome(RunStatus.OK if ok else RunStatus.CONTROLLER_ALARM) for ok in oks]
    )


def test_progress_counts_runs_and_those_that_failed():
    parts = [Flown(range(3), None, ending(True, False, True)), Flown(range(3, 5), None, None, "lost")]
    assert _tally(parts) == (5, 3)
    assert _tally(parts[:1]) == (3, 1)


def test_only_a_total_loss_is_an_error():
    lost = Flown(range(2), None, None, "its process died", died=True)
    raised = Flown(range(2), None, None, "ValueError: no")
    for flown in ([], [lost, Flown(range(1), None, ending(True))], [Flown(range(1), None, ending(False))]):
        _refuse_total_loss(flown)
    with pytest.raises(GncOptError, match=r"not one run could be flown \(its process died\).*__name__"):
        _refuse_total_loss([lost, lost])
    with pytest.raises(GncOptError, match="simulate") as refused:
        _refuse_total_loss([raised, lost])
    assert "__name__" not in str(refused.value)


def test_parameters_of_lost_batches_are_drawn_again():
    def draw(batch):
        if 7 in batch:
            raise ValueError("no luck")
        return np.full((3, len(batch)), 5.0)

    mission = SimpleNamespace(parameters=draw, flight=SimpleNamespace(layout=LAYOUTS["parameter"]))
    known = Flown(range(2), np.ones((3, 2)), None)
    found = _with_parameters([known, Flown(range(2, 5), None, None), Flown(range(6, 8), None, None)], mission)
    assert [np.shape(f.parameters) for f in found] == [(3, 2), (3, 3), (3, 2)]
    assert np.all(found[0].parameters == 1) and np.all(found[1].parameters == 5)
    assert np.all(np.isnan(found[2].parameters))


def test_what_cannot_travel_is_refused_where_it_would_have_to():
    mission = SimpleNamespace(cannot=lambda: None)
    _shared(mission, "serial")
    for executor in (None, ThreadPoolExecutor(1)):
        with pytest.raises(GncOptError, match="the campaign cannot be sent"):
            _shared(mission, executor)


# --- dispersions ------------------------------------------------------------------------------------------


class Dice:
    """A generator that draws what it is told."""

    def __init__(self, normal=(), uniform=(), integer=0):
        self.normal, self.uniform, self.integer = list(normal), list(uniform), integer

    def standard_normal(self, size):
        return np.array([self.normal.pop(0) for _ in range(size)])

    def random(self, size=None):
        return self.uniform.pop(0) if size is None else np.array([self.uniform.pop(0) for _ in range(size)])

    def integers(self, high):
        return min(self.integer, high - 1)


TWO = np.array([10.0, -20.0])


@pytest.mark.parametrize(
    ("dispersion", "dice", "drawn"),
    [
        (Normal([1, 2], mean=0.5), Dice([1, -1]), [11.5, -21.5]),
        (Normal(0.1, relative=True), Dice([1, -1]), [11, -18]),
        (Normal(2.0, truncate=1.0), Dice(uniform=[0.0, 1.0]), [8, -18]),
        (Normal(2.0, truncate=1.0), Dice(uniform=[0.5, 0.5]), [10, -20]),
        (Uniform([1, 2], [3, 6]), Dice(uniform=[0.5, 0.25]), [12, -17]),
        (Uniform(-0.1, 0.1, relative=True), Dice(uniform=[1.0, 0.0]), [11, -18]),
        (Choice([[1, 2], [3, 4], 5]), Dice(integer=1), [3, 4]),
        (Choice([[1, 2], [3, 4], 5]), Dice(integer=9), [5, 5]),
        (RandomDirection(5.0), Dice([3.0, -4.0]), [13, -24]),
        (RandomDirection(5.0), Dice([0.0, 0.0, 3.0, -4.0]), [13, -24]),
        (RandomDirection(Uniform(0.0, 10.0)), Dice([3.0, -4.0], [0.5]), [13, -24]),
        (UniformInBall(5.0), Dice([3.0, -4.0], [0.25]), [11.5, -22]),
    ],
)
def test_draws_by_hand(dispersion, dice, drawn):
    dispersion.check("x", TWO)
    assert dispersion.draw(dice, TWO) == pytest.approx(drawn, rel=1e-12)


def test_a_turn_by_hand():
    """About x by a right angle: (1, 0, 0, 0) becomes (1, 1, 0, 0) / sqrt 2, zero parameters tan(pi / 8) of x."""
    turn = RandomRotation(np.pi / 2)
    half = np.sqrt(0.5)
    assert turn.draw(Dice([2.0, 0, 0]), np.array([1.0, 0, 0, 0])) == pytest.approx([half, half, 0, 0])
    assert turn.draw(Dice([2.0, 0, 0]), np.zeros(3)) == pytest.approx([np.tan(np.pi / 8), 0, 0])
    first = np.array([half, 0, half, 0])
    once = turn.draw(Dice([2.0, 0, 0]), first)
    assert once == pytest.approx(quaternion_product(first, [half, half, 0, 0]))


@pytest.mark.parametrize(
    ("dispersion", "nominal", "message"),
    [
        (Normal([1.0, 2.0, 3.0]), TWO, "standard deviation of 'x'"),
        (Normal(1.0, mean=[1.0, 2.0, 3.0]), TWO, "mean deviation of 'x'"),
        (Normal(1.0, relative=True), 0 * TWO, "nominally zero"),
        (Uniform([0.0] * 3, 1.0), TWO, "lower end of 'x'"),
        (Uniform(0.0, [1.0] * 3), TWO, "upper end of 'x'"),
        (Uniform(0.0, 1.0, relative=True), 0 * TWO, "nominally zero"),
        (Choice([1.0, [1.0] * 3]), TWO, "choice of 'x'"),
        (RandomRotation(0.1), TWO, "neither a quaternion"),
        (RandomRotation(0.1), np.array([1.0, 1e-2, 0, 0]), "no unit quaternion"),
    ],
)
def test_dispersions_that_do_not_fit(dispersion, nominal, message):
    with pytest.raises(ArgumentError, match=message):
        dispersion.check("x", nominal)


def test_dispersions_that_fit():
    Normal(1.0, relative=True).check("x", np.array([0.0, 1.0]))
    RandomRotation(0.1).check("x", np.array([1.0, 1e-4, 0, 0]))
    RandomRotation(0.1).check("x", np.array([5.0, 1.0, 0]))
    (
        Normal(0.0),
        Uniform(1.0, 1.0),
        RandomDirection(0.0),
        UniformInBall(0.0),
        RandomRotation(Normal(0.1)),
        RandomDirection(Uniform(0.0, 1.0)),
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Normal([1.0, -1.0]), "standard deviation"), (lambda: Normal(1.0, mean=INF), "mean"),
        (lambda: Normal(INF), "finite"), (lambda: Normal(1.0, truncate=-1.0), "truncate"),
        (lambda: Uniform([0.0, 2.0], [1.0, 1.0]), "lower end first"), (lambda: Uniform(0.0, INF), "high"),
        (lambda: Uniform(NAN, 0.0), "low"),
        (lambda: RandomDirection(Uniform(0, 1, relative=True)), "relative to nothing"),
        (lambda: RandomDirection(Normal([1.0, 2.0])), "radius"), (lambda: RandomRotation(-0.1), "angle"),
        (lambda: UniformInBall(-1.0), "radius"),
    ],
)  # fmt: skip
def test_dispersions_that_make_no_sense(wrong, message):
    with pytest.raises(ArgumentError, match=message):
        wrong()


# --- statistics and metrics -------------------------------------------------------------------------------


def test_one_and_many_runs():
    assert pass_rate(0, 1).low == 0.0 and pass_rate(1, 1).rate == 1.0
    assert percentile([3.0], 0.5).value == 3.0 and percentile([3.0], 0.5).low == -INF
    assert percentile(np.arange(1, 101.0), 0.07).value == 7.0  # 0.07 * 100 is a little more than 7
    assert percentile([3.0, 1.0, 2.0], 1e-6).value == 1.0
    assert share_below_maximum(1, 0.9) == pytest.approx(0.1)
    wide, narrow = (pass_rate(50, 100, c) for c in (0.99, 0.5))
    assert wide.low < narrow.low < 0.5 < narrow.high < wide.high and narrow.confidence == 0.5
    wide, narrow = (percentile(np.arange(100.0), 0.5, c) for c in (0.99, 0.5))
    assert wide.low < narrow.low < narrow.high < wide.high
    for wrong in (lambda: pass_rate(1, 0), lambda: pass_rate(-1, 2), lambda: pass_rate(1, 2, 1.0),
                  lambda: percentile([1.0], 0.0), lambda: share_below_maximum(0)):  # fmt: skip
        with pytest.raises(ArgumentError):
            wrong()


@pytest.mark.parametrize(
    ("rate", "text"),
    [((1, 2), "50.0 %"), ((1, 100), "1.0 %"), ((1, 1001), "0.100 %"), ((1, 10**7), "0.0000 %")],
)
def test_small_shares_have_digits(rate, text):
    assert str(pass_rate(*rate)).split(" (")[0] == text


def test_attitudes_of_other_sizes_and_bands_of_none_are_refused():
    with pytest.raises(ArgumentError, match="5 components"):
        rotation_angle(np.ones(5), np.ones(5))
    with pytest.raises(ArgumentError, match="band"):
        settling_time(np.arange(3.0), np.zeros(3), 0.0)


def test_a_campaign_joins_what_was_flown_and_what_was_lost():
    """Runs 0 and 1 flown, 2 lost with its parameters drawn: a column of not-a-number and a status in its place."""
    cart = double_integrator()
    flight = ClosedLoop(cart, feedback(cart, [[1.0, 1.6]]), dt=0.1, substeps=1).compile(
        [1.0, 0.0], t0=2.0, tf=2.5
    )
    mission = CampaignTask(flight, {}, 4)
    (flown,) = mission.fly(range(2))
    goal = np.array([0.5, np.nan])
    lost = Flown(range(2, 3), flight.nominal[:, None], None, "died")
    campaign = gathered(mission.flight, [flown, lost], seed=mission.seed, asked=7, goal=goal)
    assert (campaign.seed, campaign.asked, campaign.span) == (4, 7, (2.0, 2.5))
    assert campaign.indices.tolist() == [0, 1, 2] and not campaign.interrupted
    assert (
        campaign.errors[0, :2] == pytest.approx(campaign.states[0, :2] - 0.5)
        and np.isnan(campaign.errors[1]).all()
    )
    assert np.isnan(campaign.states[:, 2]).all() and np.isnan(campaign.integration_error[2])
    assert [o.status for o in campaign.outcomes] == [RunStatus.OK, RunStatus.OK, RunStatus.LOST]
    assert campaign.outcomes[2].what == "died" and campaign.parameters.shape == (flight.layout.size, 3)
    for name, size in (("effort", 1), ("energy", 1), ("saturation_time", 1), ("variation", 1)):
        assert getattr(campaign, name).shape == (size, 3)
    empty = gathered(mission.flight, [], seed=mission.seed, asked=7, goal=goal)
    assert (
        len(empty) == 0 and empty.errors.shape == (2, 0) and empty.parameters.shape == (flight.layout.size, 0)
    )
    assert replace(campaign, limits={"q": 1.0}).passed().tolist() == [True, True, False]


def test_a_batch_that_raises_is_flown_in_halves():
    cart = double_integrator()
    flight = ClosedLoop(cart, feedback(cart, [[1.0, 1.6]]), dt=0.1, substeps=1).compile([1.0, 0.0], tf=0.2)

    class Unlucky(Normal):
        def draw(self, generator, nominal):
            if abs(generator.random() - first) < 1e-12:
                raise ValueError("no luck")
            return nominal

    sequence = np.random.SeedSequence([9, 5], spawn_key=(zlib.crc32(b"plant.m"),))
    first = np.random.Generator(np.random.Philox(sequence)).random()
    parts = CampaignTask(flight, {"plant.m": Unlucky(1.0)}, 9).fly(range(3, 8))
    assert [list(p.batch) for p in parts] == [[3, 4], [5], [6, 7]]
    assert [p.ending is None for p in parts] == [False, True, False] and "no luck" in parts[1].mishap
