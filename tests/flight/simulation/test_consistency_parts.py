"""Errors against covariances, in numbers: estimates that are given by hand."""

import importlib
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.special import gammainc, gammaincinv

from gnc_opt.errors import ArgumentError
from gnc_opt.model import Layout, Variable

c = importlib.import_module("gnc_opt.analysis.filter_consistency")  # the package gives its function

STATES = Layout("state", (Variable("q", 2), Variable("v"), Variable("inner")))
PLANT = Layout("state", (Variable("v"), Variable("other"), Variable("q", 2)))
MEMORY = Layout("memory", tuple(Variable(f"gps_{what}") for what in ("nis", "taken", "refused")))
COVARIANCE = np.array(
    [[4.0, 1.0, 0.5, 0.1], [1.0, 9.0, -1.0, 0.2], [0.5, -1.0, 1.0, 0.3], [0.1, 0.2, 0.3, 2.0]]
)


def estimator(covariance=COVARIANCE, states=STATES):
    """Its memory holds the estimate; a state of the plant less its estimate is the error."""
    a, b = ca.SX.sym("a", 4), ca.SX.sym("b", 4)
    return SimpleNamespace(
        name="filter", states=states, errors=states, sizes={"gps": 3}, memory=MEMORY,
        estimate=lambda memory: memory[:4].copy(), error=ca.Function("e", [a, b], [a - b]),
        covariance=lambda memory: np.tile(covariance, (memory.shape[1], 1, 1)), gates={},
    )  # fmt: skip


def flown(states):
    return SimpleNamespace(layouts={"state": PLANT}, states=np.asarray(states, float))


def test_errors_are_measured_by_the_covariance_of_what_plant_and_estimator_share():
    estimate = np.array([[1.0, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12], [0, 0, 0, 0]])
    plant = np.array([[9.5, 9, np.nan, 14], [7, 7, 7, 7], [2, 2, 2, 2.5], [5, 4, 8, 8]])
    found, components = c._compute_nees(flown(plant), estimator(), estimate)
    errors = np.array([plant[2] - estimate[0], plant[3] - estimate[1], plant[0] - estimate[2]])
    P = COVARIANCE[:3, :3]
    expected = [e @ np.linalg.solve(P, e) for e in errors.T]
    assert components == 3 and found[[0, 1, 3]] == pytest.approx([expected[i] for i in (0, 1, 3)])
    assert np.isnan(found[2])


def test_states_that_are_known_exactly_or_not_there_are_refused():
    singular = COVARIANCE.copy()
    singular[1] = singular[:, 1] = 0.0
    with pytest.raises(ArgumentError, match=r"treats 'q\[1\]' as exactly known"):
        c._compute_nees(flown(np.ones((4, 2))), estimator(singular), np.zeros((4, 2)))
    tiny = np.diag([1.0, 1e-15, 1.0, 1.0])  # of a state of 0.03 that is less than rounding leaves
    with pytest.raises(ArgumentError, match=r"treats 'q\[1\]' as exactly known \(variance"):
        c._compute_nees(flown(np.full((4, 2), 0.03)), estimator(tiny @ COVARIANCE @ tiny), np.zeros((4, 2)))
    other = Layout("state", (Variable("a", 2), Variable("b"), Variable("c")))
    with pytest.raises(ArgumentError, match="no state that 'filter' estimates"):
        c._compute_nees(flown(np.ones((4, 2))), estimator(states=other), np.zeros((4, 2)))


def below(mean, components, values):
    """Probability that the mean of so many chi-square values is below some mean."""
    return gammainc(0.5 * components * values, 0.5 * mean * values)


def test_a_mean_of_chi_squares_is_within_its_band_as_often_as_promised():
    for components, values, confidence in ((3, 1, 0.95), (2, 50, 0.9), (1, 7, 0.5)):
        low, high = c._compute_chi_square_interval(components, values, confidence)
        assert below(low, components, values) == pytest.approx(0.5 - confidence / 2, abs=1e-9)
        assert below(high, components, values) == pytest.approx(0.5 + confidence / 2, abs=1e-9)
    assert np.isnan(c._compute_chi_square_interval(3, 0, 0.95)).all()
    assert np.isfinite(c._compute_chi_square_interval(3, 1, 0.95)).all()


@pytest.mark.parametrize(("components", "gate"), [(1, 0.99), (1, 0.8), (3, 0.95)])
def test_a_mean_behind_a_gate_is_within_its_band_as_often_as_promised(components, gate):
    rng, values, confidence = np.random.default_rng(3), 40, 0.9
    draws = rng.chisquare(components, 260_000)
    passed = draws[draws <= 2 * gammaincinv(components / 2, gate)]
    means = passed[: passed.size // values * values].reshape(-1, values).mean(axis=1)
    low, high = c._compute_chi_square_interval(components, values, confidence, gate)
    assert np.mean(means < low) == pytest.approx(0.05, abs=0.012)
    assert np.mean(means > high) == pytest.approx(0.05, abs=0.012)


def test_innovations_are_averaged_over_all_samples_taken():
    ends = np.array([[30.0, 6.0, np.nan], [10.0, 2.0, np.nan], [1.0, 2.0, np.nan]])
    found = c._test_innovation_consistency(estimator(), "gps", ends, 0.9)
    assert (found.average, found.taken, found.refused) == (3.0, 12, 3)
    assert found.band == c._compute_chi_square_interval(3, 12, 0.9) and found.ok
    none = c._test_innovation_consistency(estimator(), "gps", 0 * ends[:, :1], 0.9)
    assert np.isnan(none.average) and not none.ok and none.taken == 0


@pytest.mark.parametrize(
    ("average", "ok"), [(1.0, True), (2.0, True), (3.0, True), (0.99, False), (3.01, False)]
)
def test_means_within_their_bands_are_ok_ends_included(average, ok):
    test = c.InnovationTest(average, (1.0, 3.0), 5, 0)
    assert test.ok is ok
    right = c.InnovationTest(2.0, (1.0, 3.0), 5, 0)
    nees = np.array([1.0])
    campaign = c.Consistency(nees, average, (1.0, 3.0), 2, True, 0.95, {"a": right})
    assert campaign.ok is ok
    run = c.Consistency(nees, average, (1.0, 3.0), 2, False, 0.95, {"a": right})
    assert run.ok  # successive values of a run depend on each other
    assert c.Consistency(nees, 2.0, (1.0, 3.0), 2, False, 0.95, {"a": right, "b": test}).ok is ok
