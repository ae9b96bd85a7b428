"""Sobol' indices: the budget of a linear loop, the Ishigami function, coverage, refusals."""

import numpy as np
import pytest
from testing.sled import MISSION, SPREAD, loop_of

import gnc_opt as go
from gnc_opt.analysis import global_sensitivity as drivers
from gnc_opt.analysis import sobol_indices
from gnc_opt.simulation import Choice, Normal, Saturation


def end_of_q(campaign):
    return campaign.error("q")[0]


@pytest.fixture(scope="module")
def found():
    return sobol_indices(
        go.Scenario(loop_of(), **MISSION, dispersions=SPREAD, measures={"end": end_of_q}), "end", n=200,
        executor="serial",
    )  # fmt: skip


def test_of_a_linear_loop_they_are_the_budget_of_the_linear_covariance(found):
    theory = go.linear_covariance(go.Scenario(loop_of(), **MISSION, dispersions=SPREAD)).variance_budget("q")
    expected = {name: theory[name] for name in SPREAD}
    expected["noise"] = 1 - sum(expected.values())
    assert set(found.total) == set(expected)
    for name, share in expected.items():
        for index in (found.first[name], found.total[name]):
            assert index.low - 0.02 < share < index.high + 0.02
            assert index.high - index.low < 0.6
    assert found.rows == 200 and found.lost == 0
    assert [line.split()[0] for line in str(found).splitlines()[2:5]] == sorted(
        expected, key=lambda n: -found.total[n].value
    )


def ishigami(x):
    return np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def rows(generator, n):
    """Values of A, B and AB_i of the Ishigami function."""
    a, b = generator.uniform(-np.pi, np.pi, (2, 3, n))
    mixed = [np.where(np.arange(3)[:, None] == i, b, a) for i in range(3)]
    return np.array([ishigami(x) for x in (a, b, *mixed)])


def test_estimates_of_the_ishigami_function_are_those_of_its_closed_form():
    """Ishigami and Homma (1990): V = a^2/8 + b pi^4/5 + b^2 pi^8/18 + 1/2."""
    a, b, pi = 7, 0.1, np.pi
    V = a**2 / 8 + b * pi**4 / 5 + b**2 * pi**8 / 18 + 0.5
    V1, V2, V13 = 0.5 * (1 + b * pi**4 / 5) ** 2, a**2 / 8, b**2 * pi**8 * (1 / 18 - 1 / 50)
    first, total = drivers.estimate_sobol_indices(rows(np.random.default_rng(3), 200_000))
    assert first == pytest.approx([V1 / V, V2 / V, 0], abs=0.01)
    assert total == pytest.approx([(V1 + V13) / V, V2 / V, V13 / V], abs=0.01)


def test_intervals_hold_the_truth_as_often_as_they_say(monkeypatch):
    monkeypatch.setattr(drivers, "_RESAMPLED", 200)
    truth, hits, repeats = 0.5576, 0, 40  # total index of x_1
    for k in range(repeats):
        f = rows(np.random.default_rng(k), 200)
        share = drivers._bootstrap_sobol_indices("f", ("1", "2", "3"), f, 200, 0.9, k).total["1"]
        hits += share.low <= truth <= share.high
    assert 30 <= hits <= 40  # 90 % of 40, within three standard deviations


def test_a_measure_that_does_not_vary_is_refused():
    with pytest.raises(go.ArgumentError, match="'constant' does not vary"):
        sobol_indices(
            go.Scenario(
                loop_of(),
                **MISSION,
                dispersions=SPREAD,
                measures={"constant": lambda campaign: np.ones(len(campaign))},
            ),
            "constant",
            n=10,
            executor="serial",
        )
    with pytest.raises(go.UnknownNameError):
        sobol_indices(go.Scenario(loop_of(), **MISSION, dispersions=SPREAD), "nothing")
    with pytest.raises(go.ArgumentError, match="number of rows"):
        sobol_indices(go.Scenario(loop_of(), **MISSION, dispersions=SPREAD), "q", n=3)


def test_rows_with_failed_runs_are_left_out_and_counted():
    spread = SPREAD | {"limit.upper": Choice([1.0] * 9 + [-5.0])}
    loop = loop_of(actuators=[Saturation("limit", -1.0, 1.0)], divergence_limits={"q": 0.8})
    with pytest.raises(go.GncOptError, match=r"rows .* have a failed run"):
        sobol_indices(
            go.Scenario(loop, **MISSION, dispersions=spread | {"initial.q": Normal(3.0)}), "q", n=20,
            executor="serial",
        )  # fmt: skip
