"""multistart: finds known local minima, throws out spurious ones, and depends on nothing but the seed."""

from __future__ import annotations

import itertools
import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.internals import solve_problem_on_mesh
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt import Multistart, cli, multistart
from gnc_opt.planning.problem.guess.random_guess import (
    does_start_keep_guess_shape,
    find_periods_of_angular_states,
    with_random_guess,
)
from gnc_opt.planning.study.multistart_search import (
    RefinementTask,
    _CoarseTask,
    _count_minima_to_refine,
    _get_worker_result,
    _halve_mesh_segments,
)
from gnc_opt.workers.worker_pool import TaskResult, WorkerDiedError
from problems import rendezvous

WEIGHT = 0.02
MESH = "6x3"
PATIENCE = 300.0
"""Longest wait for a program to show a sign of life and to end, s."""


def wells(tilt: float = 0.1) -> go.Problem:
    """A point that ends in one of two wells: with u constant and x(1) = z, J = (z^2 - 1)^2 + tilt z + WEIGHT z^2."""
    model, _x, u = dynamics("point", "x", "u", lambda x, u: {x: u})
    problem, leg = one_phase("two wells", model, initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-3.0, 3.0))
    z = leg.final_state("x")
    problem.minimize((z**2 - 1) ** 2 + tilt * z + WEIGHT * leg.integral(u**2))
    return problem


build = wells
"""For the command line."""


def well_depths(tilt: float = 0.1) -> list[float]:
    """The two local minima of J(z), best first, from the roots of dJ/dz."""
    z = np.roots([4.0, 0.0, 2 * WEIGHT - 4.0, tilt]).real
    z = z[12 * z**2 - 4 + 2 * WEIGHT > 0]
    return sorted((z**2 - 1) ** 2 + tilt * z + WEIGHT * z**2)


def search(problem: Any, **arguments: Any) -> Multistart:
    return multistart(problem, **{"n": 8, "seed": 3, "mesh": MESH, "executor": "serial", **arguments})


@cache
def alone() -> Multistart:
    """What one process finds."""
    return search(wells())


def told(found: Multistart) -> list[Any]:
    """Everything that must not depend on the executor."""
    names = ("objective", "starts", "trajectories", "coarse_objectives", "verdict_ok")
    return [[getattr(m, n) for n in names for m in found.minima], found.failures, found.finished]


@pytest.mark.slow
def test_both_wells_are_found_and_ranked() -> None:
    found = alone()
    # A quadratic cost and constant control: collocation is exact, the solver's tolerance of 1e-9 is what remains.
    assert [m.objective for m in found.minima] == pytest.approx(well_depths(), abs=1e-8)
    assert sum(m.hits for m in found.minima) == 8 and not found.failures
    assert all(m.verdict_ok and m.refined and m.hits == len(m.starts) > 0 for m in found.minima)
    assert sorted(start for m in found.minima for start in m.starts) == list(range(8))
    assert found.best is found.minima[0] and found.best.solution.state("x")(1.0) < 0
    assert "2 minima from 8 of 8 starts, seed 3" in str(found) and repr(found).endswith("seed 3>")


@pytest.mark.slow
def test_mirror_twins_are_one_minimum_with_two_trajectories() -> None:
    (minimum,) = search(wells(tilt=0.0)).minima
    assert (minimum.hits, minimum.trajectories) == (8, 2)


@pytest.mark.slow
def test_the_largest_payoff_comes_first() -> None:
    problem = wells()
    negative = go.Problem("two hills")
    leg = negative.phase("leg", problem.get_phase().model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=0.0)
    leg.bounds(u=(-3.0, 3.0))
    z = leg.final_state("x")
    negative.maximize(-((z**2 - 1) ** 2) - 0.1 * z - WEIGHT * leg.integral(leg.model.symbol("u") ** 2))
    found = search(negative, refine=False)
    assert [-m.objective for m in found.minima] == pytest.approx(well_depths(), abs=1e-8)
    assert not any(m.refined or m.verdict_ok for m in found.minima)


@pytest.mark.slow
def test_the_answer_does_not_depend_on_the_executor() -> None:
    expected = told(alone())
    assert told(search(wells(), executor=None)) == expected  # worker processes
    with ThreadPoolExecutor(3) as pool:
        assert told(search(partial(wells, tilt=0.1), executor=pool)) == expected


def test_guesses_depend_on_seed_and_index_alone() -> None:
    problem = wells()

    def guess(seed: int, index: int) -> Any:
        return with_random_guess(problem, seed, index).get_phase().numbers.guess.values["u"]

    again = guess(1, 3)
    guess(5, 5)
    assert np.array_equal(guess(1, 3), again)
    assert not np.array_equal(guess(1, 4), again)
    assert not np.array_equal(guess(2, 3), again)
    assert with_random_guess(problem, 1, 0) is problem


@pytest.mark.parametrize("index", range(1, 10))
def test_guesses_respect_bounds_ends_and_times(index: int) -> None:
    leg = with_random_guess(rendezvous.build(case=3), 7, index).get_phase()
    time, values = leg.numbers.guess.time, leg.numbers.guess.values
    assert time is not None and time[0] == 0.0 and 1.0 <= time[-1] <= 100.0
    assert np.max(np.abs(values["F_B"])) <= rendezvous.MAX_FORCE
    assert np.max(np.abs(values["sigma"])) <= 1.0
    assert values["r_L"][:, 0] == pytest.approx(rendezvous.CASES[3])
    assert values["r_L"][:, -1] == pytest.approx(rendezvous.FINAL_POSITION)


def test_free_parameters_are_drawn_within_their_bounds() -> None:
    model = go.Model("gain")
    x, k = model.state("x"), model.parameter("k", 1.0)
    model.ode({x: -k * x})
    problem = go.Problem("fit")
    problem.parameter("k", lower=0.5, upper=2.0, guess=1.0)
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=1.0)
    leg.initial(x=1.0)
    problem.minimize((leg.final_state("x") - 0.5) ** 2)
    drawn = [with_random_guess(problem, 0, i).parameter_guess["k"][0] for i in range(1, 20)]
    assert 0.5 <= min(drawn) < 0.9 and 1.5 < max(drawn) <= 2.0
    assert problem.parameter_guess["k"] == [1.0]


def spiral(final_angle: float | None = None, first_angle: Any = 0.0) -> go.Problem:
    """A point that turns about the origin and moves outwards."""
    model = go.Model("spiral")
    r, angle, speed = model.state("r"), model.state("angle"), model.control("speed")
    model.ode({r: speed * (2 + ca.cos(angle)), angle: 1 / r})
    problem, leg = one_phase("spiral", model, initial=0.0, final=(0.1, 1000.0), name="out")
    leg.initial(r=1.0, angle=first_angle)
    leg.final(r=2.0)
    if final_angle is not None:
        leg.final(angle=final_angle)
    leg.bounds(r=(0.5, 3.0), angle=(-1.0, 40.0), speed=(0.0, 1.0))
    leg.guess([0.0, 10.0], angle=(0.0, 9.0))
    problem.minimize(leg.final_time)
    return problem


def test_durations_are_drawn_over_decades_and_angles_make_whole_turns() -> None:
    problem = spiral()
    np.testing.assert_allclose(find_periods_of_angular_states(problem, problem.get_phase()), [0.0, 2 * np.pi])
    guesses = [with_random_guess(problem, 0, k).get_phase().numbers.guess for k in range(1, 60)]
    durations = np.array([guess.time[-1] for guess in guesses if guess.time is not None])
    assert np.min(durations) < 1.5 and np.max(durations) > 60.0  # the guess is 10
    assert 5.0 < np.exp(np.mean(np.log(durations))) < 20.0  # log-uniform about it
    ends = [
        np.ravel(with_random_guess(problem, 0, k).get_phase().numbers.guess.values["angle"])[-1]
        for k in range(1, 200)
        if does_start_keep_guess_shape(k)
    ]
    turns = (np.array(ends) - 9.0) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert set(np.round(turns)) == {-1.0, 0.0, 1.0, 2.0, 3.0, 4.0}  # all that the bounds allow
    fixed = with_random_guess(spiral(final_angle=9.0), 0, 2).get_phase().numbers.guess.values["angle"]
    assert np.ravel(fixed)[-1] == pytest.approx(9.0)


@pytest.mark.parametrize(
    ("first", "last", "duration", "longest"),
    [((2.0, 3.0), 5.0, (1.0, 2.6), 2.6), (1.0, (2.5, 3.8), (2.0, 4.0), 2.8)],
)
def test_drawn_times_fill_what_all_their_limits_allow(
    first: Any, last: Any, duration: Any, longest: float
) -> None:
    model = dynamics("drift", "x", "u", lambda x, u: {x: u})[0]
    problem, _ = one_phase("drift", model, first, last, duration=duration)
    times = [with_random_guess(problem, 0, k).get_phase().numbers.guess.time[[0, -1]] for k in range(1, 60)]
    spans = np.diff(times).ravel()
    assert 2.0 <= np.min(spans) < 2.05 and longest - 0.05 < np.max(spans) <= longest + 1e-12
    assert {first, last} & set(np.ravel(times))  # the fixed one


def test_a_free_initial_angle_is_drawn_from_the_revolution_about_its_guess() -> None:
    """The guess is 0: the draws fill its revolution within the bounds, from -1 rad on, and the angle ends in them."""
    drawn = [with_random_guess(spiral(None, (-9.0, 9.0)), 0, k).get_phase() for k in range(1, 300)]
    angles = np.array([leg.numbers.guess.values["angle"].ravel()[[0, -1]] for leg in drawn])
    kept = angles[[does_start_keep_guess_shape(k) for k in range(1, 300)]]
    assert -1.0 <= np.min(kept[:, 0]) < -0.9 and 3.0 < np.max(kept[:, 0]) <= np.pi
    assert np.mean(kept[:, 0] > 1.0) == pytest.approx((np.pi - 1.0) / (2 * np.pi), abs=0.1)
    assert np.min(kept[:, 1]) >= -1.0 and np.max(kept[:, 1]) <= 40.0


def test_minima_to_refine_are_those_within_a_share_of_the_best() -> None:
    for objectives, share, count in (
        ([-2.0, -1.875, -1.0], 0.0625, 2),
        ([2.0, 2.5, 2.51], 0.25, 2),
        ([0.5], 0.0, 1),
    ):
        minima: Any = [SimpleNamespace(objective=value) for value in objectives]
        assert _count_minima_to_refine(minima, share) == count
        assert _count_minima_to_refine(minima, None) == len(minima) and not _count_minima_to_refine([], share)
    assert _halve_mesh_segments(go.Mesh((0.0, 0.2, 1.0), (3, 5))) == go.Mesh(
        (0.0, 0.1, 0.2, 0.6, 1.0), (3, 3, 5, 5)
    )


@pytest.mark.slow
def test_a_minimum_whose_short_arcs_the_coarse_mesh_hides_is_refined_all_the_same() -> None:
    # The fourth minimum of case 2. From its 20x3 solution the switch times lead to a structure that lacks an
    # arc and that the verdict rejects; on halved segments the arc is seen.
    problem = rendezvous.build(case=2)
    options = go.SolverOptions(max_iterations=400)
    endings = (_CoarseTask(1, "20x3", options)(problem, k) for k in (41, 59))
    # Where a start ends may depend on the machine's rounding, hence two of them.
    coarse = next(e for e in endings if e.objective is not None and abs(e.objective - 26.2288) < 1e-3)
    assert coarse.solution is not None and coarse.objective is not None
    known = set(problem.builds)
    minimum = go.Minimum(coarse.solution, coarse.objective, 1, (coarse.index,), 1, (coarse.objective,))
    assert minimum.check_result == "coarse"
    fine = RefinementTask("bang-bang", 1e-8, go.RefinementLimits())(problem, minimum)
    assert fine.check_result == "ok"
    assert fine.objective == pytest.approx(26.22674, abs=1e-5)
    assert set(problem.builds) == known  # what was built for it is released


@pytest.mark.parametrize("executor", ["serial", None])
def test_ctrl_c_keeps_what_is_found(monkeypatch: pytest.MonkeyPatch, executor: Any) -> None:
    count = 0

    @contextmanager
    def impatient_meter(*_: Any) -> Iterator[Any]:
        def show(objective: float | None) -> None:
            nonlocal count
            count += 1
            if count == 5:
                signal.raise_signal(signal.SIGINT)

        yield show

    monkeypatch.setattr(sys.modules[multistart.__module__], "_display_search_progress", impatient_meter)
    found = search(wells(), n=400, executor=executor)
    assert found.interrupted and 5 <= found.finished < 400
    assert sum(m.hits for m in found.minima) == found.finished
    assert not any(m.refined for m in found.minima) and "interrupted" in str(found)


def test_an_interrupted_solve_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    module = sys.modules[multistart.__module__]
    monkeypatch.setattr(module, "solve_problem_on_mesh", _interrupting_solve(at=4))
    found = search(wells(), n=400)
    assert found.interrupted and found.finished == 3


def test_ctrl_c_stops_running_workers(
    monkeypatch: pytest.MonkeyPatch, ctrl_c_when: Any, tmp_path: Path
) -> None:
    """Solves that would go on for very long end with the search, and so do their processes."""

    def endless(*_: Any, **__: Any) -> None:
        (tmp_path / str(os.getpid())).touch()
        time.sleep(1000.0)

    monkeypatch.setattr(sys.modules[multistart.__module__], "solve_problem_on_mesh", endless)
    crew = min(2, os.cpu_count() or 1)
    ctrl_c_when(lambda: len(list(tmp_path.iterdir())) == crew)  # CPython loses one that comes while it forks
    found = search(wells(), n=5, executor=None)
    assert found.interrupted and found.finished == 0 and not found.minima
    assert not multiprocessing.active_children()


@pytest.mark.slow
def test_what_a_broken_executor_leaves_is_searched_all_the_same() -> None:
    left = search(partial(_dies_elsewhere, os.getpid()), n=4, refine=False, executor=ProcessPoolExecutor(1))
    assert told(left) == told(search(wells(), n=4, refine=False))


def test_a_dead_worker_is_reported() -> None:
    with pytest.raises(go.GncOptError, match="a process of multistart\\(\\) has died"):
        _get_worker_result(TaskResult(0, None, WorkerDiedError()))


def _dies_elsewhere(home: int) -> go.Problem:
    if os.getpid() != home:
        os.kill(os.getpid(), signal.SIGKILL)
    return wells()


def test_a_time_limit_does_not_end_the_search() -> None:
    found = search(wells(), n=3, options=go.SolverOptions(max_wall_time=1e-9))
    assert (dict(found.failures), found.interrupted) == ({"interrupted": 3}, False)
    with pytest.raises(go.GncOptError, match="none of 3 starts of 'two wells' found a minimum"):
        _ = found.best


def test_refinements_share_the_work_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of it is for two minima; the other half for the best, which does not pass the check."""
    module, shares = sys.modules[multistart.__module__], []

    def recorded(coarse: go.Solution, *, limits: Any, **_: Any) -> go.Solution:
        shares.append(limits.max_work)
        return coarse

    monkeypatch.setattr(module, "refine_solution", recorded)
    monkeypatch.setattr(module, "verify", lambda _: SimpleNamespace(ok=False))
    search(wells(), n=8, max_refined=2, limits=go.RefinementLimits(max_work=8.0))
    assert shares == [2.0, 2.0, 4.0]


def _interrupting_solve(at: int) -> Any:
    """A solve whose call number ``at`` ends as it does on Ctrl-C."""
    calls = itertools.count(1)

    def solve(*arguments: Any, **more: Any) -> go.Solution:
        solution = solve_problem_on_mesh(*arguments, **more)
        return replace(solution, status=go.Status.INTERRUPTED) if next(calls) == at else solution

    return solve


@pytest.mark.slow
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = Path(__file__)  # wells() and build(): this file is a problem file
    target = tmp_path / "found.json"
    arguments = [
        "multistart",
        str(file),
        "--n",
        "6",
        "--seed",
        "3",
        "--mesh",
        MESH,
        "--set",
        "tilt=0.2",
        "--quiet",
    ]
    assert cli.main([*arguments, "--json", str(target)]) == 0
    told = json.loads(target.read_text())
    assert [m["objective"] for m in told["minima"]] == pytest.approx(well_depths(0.2), abs=1e-8)
    assert told["finished"] == 6 and sum(m["hits"] for m in told["minima"]) == 6
    assert told["minima"][0]["verdict_ok"] and told["minima"][0]["solution"]["solved"]
    assert cli.main(["multistart", str(file), "--n", "0"]) == 2
    assert "number of starts" in capsys.readouterr().err


class Unused(ProcessPoolExecutor):
    """Hangs at times, for ever, when what it sends cannot be pickled: so it is not tried."""

    def submit(self, *_: Any, **__: Any) -> Any:
        pytest.fail("something was sent")


def test_a_problem_cannot_travel_to_foreign_processes() -> None:
    with Unused(1) as pool, pytest.raises(go.GncOptError, match="give a function that builds it"):
        search(wells(), executor=pool)


def test_a_builder_must_be_picklable() -> None:
    with ProcessPoolExecutor(1) as pool, pytest.raises(go.GncOptError, match="define it with def"):
        search(lambda: wells(), executor=pool)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n": 0}, "number of starts"),
        ({"seed": -1}, "seed"),
        ({"structure": "bangbang"}, "bang-bang"),
        ({"executor": "threads"}, "executor"),
        ({"tol": 0.0}, "tolerance"),
        ({"options": {}}, "options"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(go.GncOptError, match=message):
        search(wells(), **arguments)


def test_wrong_problems_are_named() -> None:
    with pytest.raises(go.GncOptError, match=r"must be a Problem or a function .* not of type int"):
        search(3)
    with pytest.raises(go.GncOptError, match="the result of the builder"):
        search(list)
