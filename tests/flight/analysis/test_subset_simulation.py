"""Rare failures: normal tails of 1e-5 to 1e-3, by numbers alone and flown, coverage, refusals."""

import numpy as np
import pytest
import scipy
from testing.sled import MISSION, SPREAD, loop_of

import gnc_opt as go
from gnc_opt.analysis import failure_probability
from gnc_opt.analysis import subset_simulation as rare
from gnc_opt.simulation import Normal, Saturation


def generator(*seed):
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))


@pytest.mark.parametrize(("p", "size"), [(1e-3, 2), (1e-4, 30), (1e-5, 300)])
def test_normal_tails_within_the_interval(p, size):
    limit, way = scipy.stats.norm.isf(p), np.ones(size) / np.sqrt(size)
    found = [rare.subset_simulation(lambda z: way @ z, size, limit, 500, generator(1, k)) for k in range(10)]
    estimates = np.array([each.probability for each in found])
    mean, low, high = rare.repeated_mean(estimates, 0.99)
    assert low < p < high and high / low < 5
    assert mean == pytest.approx(estimates.mean())
    assert len(found[0].levels) == pytest.approx(np.log10(1 / p), abs=1)


def test_two_ways_to_fail_are_both_found():
    """|z| > limit: what looks for one worst point would find half of it."""
    p = 2 * scipy.stats.norm.sf(4.0)
    found = [
        rare.subset_simulation(lambda z: np.abs(z[0]), 3, 4.0, 500, generator(2, k)).probability
        for k in range(10)
    ]
    mean, low, high = rare.repeated_mean(np.array(found), 0.99)
    assert low < p < high and mean > 0.6 * p


def test_intervals_hold_the_truth_as_often_as_they_say():
    p, hits = 1e-3, 0
    limit = scipy.stats.norm.isf(p)
    for m in range(40):
        found = [
            rare.subset_simulation(lambda z: z[0], 2, limit, 200, generator(3, m, k)).probability
            for k in range(6)
        ]
        _, low, high = rare.repeated_mean(np.array(found), 0.9)
        hits += low <= p <= high
    assert 30 <= hits <= 40


def test_a_common_failure_is_counted_at_once():
    found = rare.subset_simulation(lambda z: z[0], 1, 0.0, 1000, generator(4))
    assert found.runs == 1000 and found.probability == pytest.approx(0.5, abs=0.06)


def test_that_all_runs_fail_is_no_proof_that_all_would():
    """The interval of a binomial number, by its definition: 200 of 200 have the probability 0.025 at its low end."""
    experiment = go.Scenario(loop_of(), **MISSION, dispersions=SPREAD)
    found = failure_probability(experiment, "q", 1e-9, n=20, executor="serial")
    assert found.probability == found.high == 1.0 and found.runs == 200
    assert found.low**200 == pytest.approx(0.025)


def test_of_a_loop_it_is_the_tail_of_its_normal_ends():
    """Dispersions and noise alike: q(t_f) is normal, with the mean and sigma of the linear covariance."""
    loop, p = loop_of(), 1e-4
    theory = go.linear_covariance(go.Scenario(loop, **MISSION, dispersions=SPREAD))
    middle, sigma = theory.nominal[0, -1] + theory.mean[0, -1], theory.std("q")[0, -1]
    limit = middle + sigma * scipy.stats.norm.isf(p)
    found = failure_probability(
        go.Scenario(
            loop, **MISSION, dispersions=SPREAD, measures={"end": lambda runs: runs.state("q")[0]}, seed=5
        ),
        "end",
        limit,
        n=200,
        repetitions=6,
        confidence=0.99,
        executor="serial",
    )
    assert found.low < p < found.high and found.high / found.low < 30
    assert found.estimates.shape == (6,) and found.levels[-1] == limit
    assert np.all(np.diff(found.levels) > 0)
    assert found.runs < 0.1 / p * 6  # a campaign of as many runs would have seen nothing
    assert "P(end > " in str(found)


def test_runs_that_fail_count_as_failures():
    loop = loop_of(divergence_limits={"q": 1.2})  # start above 1.2: more than 3.5 sigma
    found = failure_probability(
        go.Scenario(loop, **MISSION, dispersions={"initial.q": Normal(0.2)}),
        "q",
        1e3,
        n=100,
        repetitions=3,
        executor="serial",
    )
    assert 0 < found.probability < 0.1


def test_a_limit_that_is_all_but_reached_reads_different_from_the_largest_value():
    with pytest.raises(go.GncOptError, match=r"exceeds 3\.0000002 less often .* found is 3"):
        failure_probability(
            go.Scenario(loop_of(), **MISSION, measures={"three": lambda runs: np.full(len(runs), 3.0)}),
            "three",
            3.0000002,
            n=10,
            repetitions=3,
            executor="serial",
        )


def test_what_never_fails_and_mistakes_are_refused():
    loop = loop_of()
    with pytest.raises(go.GncOptError, match="or never: the largest value found"):
        failure_probability(
            go.Scenario(loop, **MISSION, measures={"one": lambda runs: np.ones(len(runs))}),
            "one",
            2.0,
            n=10,
            repetitions=3,
            executor="serial",
        )
    plain = go.Scenario(loop, **MISSION)
    with pytest.raises(go.ArgumentError, match="multiple of 10"):
        failure_probability(plain, "q", 1.0, n=105)
    with pytest.raises(go.ArgumentError, match="number of repetitions"):
        failure_probability(plain, "q", 1.0, repetitions=2)
    with pytest.raises(go.ArgumentError, match="give a finite number"):
        failure_probability(plain, "q", np.inf)
    with pytest.raises(go.UnknownNameError):
        failure_probability(plain, "Q", 1.0)


def test_the_same_seed_gives_the_same_bits_on_any_executor():
    loop = loop_of(actuators=[Saturation("limit", -1.0, 1.0)])
    experiment = go.Scenario(loop, **MISSION, dispersions=SPREAD)
    asked = {"n": 20, "repetitions": 3}
    alone = failure_probability(experiment, "q", 0.3, **asked, executor="serial")
    assert np.array_equal(alone.estimates, failure_probability(experiment, "q", 0.3, **asked).estimates)
