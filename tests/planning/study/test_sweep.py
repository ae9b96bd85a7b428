"""Sweeps: closed forms over a grid, what fails costs only itself, fronts."""

import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from testing.problem_families import rest_to_rest, stiff

import gnc_opt as go

GRID = {"target": [1.0, 2.0], "k": [1.0, 4.0, 9.0]}


@pytest.fixture(scope="module")
def swept() -> go.Sweep:
    return go.sweep(
        stiff, GRID, outputs={"start": lambda s: s.control("u")(0.0)}, mesh="10x4", executor="serial"
    )


def test_objectives_and_outputs_are_the_closed_form(swept: go.Sweep) -> None:
    target, k = np.meshgrid(*GRID.values(), indexing="ij")
    root = np.sqrt(k)
    np.testing.assert_allclose(swept.objective, root * target**2 * np.tanh(root), rtol=1e-6)
    np.testing.assert_allclose(swept.array("start"), -root * target * np.tanh(root), rtol=1e-4)
    assert swept.is_solved.all() and set(swept.endings.flat) == {"optimal"} and not swept.interrupted
    np.testing.assert_array_equal(swept.array("final_time"), 1.0)
    assert swept.solutions[1, 2].with_problem(stiff(target=2.0, k=9.0)).accuracy.defect < 1e-6
    with pytest.raises(go.ArgumentError, match="did you mean 'objective'"):
        swept.array("objectiv")


def test_the_text(swept: go.Sweep) -> None:
    assert str(swept).splitlines()[0] == "sweep over 2 target x 3 k: 6 of 6 solved"


def test_neighbours_help(swept: go.Sweep) -> None:
    assert np.all(swept.array("iterations")[:, 1:] <= swept.array("iterations")[:, :1])


@pytest.mark.slow
@pytest.mark.parametrize("executor", [None, "threads"])
def test_other_executors_give_the_same(swept: go.Sweep, executor: Any) -> None:
    with ThreadPoolExecutor(2) as threads:
        again = go.sweep(
            lambda **values: stiff(**values),
            GRID,
            outputs={"start": lambda s: s.control("u")(0.0)},
            mesh="10x4",
            executor=threads if executor else None,
        )
    np.testing.assert_array_equal(again.objective, swept.objective)
    np.testing.assert_array_equal(again.array("start"), swept.array("start"))


def test_functions_that_cannot_travel_are_reported() -> None:
    with (
        ProcessPoolExecutor(1) as processes,
        pytest.raises(go.GncOptError, match="define them with def at the top"),
    ):
        go.sweep(lambda k: stiff(k), {"k": [1.0]}, executor=processes)


def family(duration: float) -> go.Problem:
    if duration == 3.0:
        raise go.ProblemError("three seconds make no sense: give others.")
    return rest_to_rest(duration)


@pytest.mark.slow
def test_points_without_a_solution_cost_only_themselves() -> None:
    found = go.sweep(family, {"duration": [5.0, 1.0, 3.0, 4.0]}, mesh="10x4", executor="serial")
    assert found.is_solved.tolist() == [True, False, False, True]
    assert found.endings.tolist() == [
        "optimal",
        "infeasible",
        "three seconds make no sense: give others.",
        "optimal",
    ]
    np.testing.assert_allclose(found.objective, [12 / 125, np.nan, np.nan, 12 / 64], rtol=1e-6)
    assert "unsolved     duration = 1: infeasible" in str(found)


def test_mistakes_in_outputs_are_reported() -> None:
    outputs = {"none": lambda s: 1 / 0}
    found = go.sweep(stiff, {"k": [1.0]}, outputs=outputs, mesh="2x3", executor="serial")
    assert found.endings.tolist() == ["ZeroDivisionError: division by zero"] and not found.is_solved.any()


@pytest.mark.parametrize(
    ("mistake", "kind"),
    [
        (lambda s: nothing, NameError),  # noqa: F821
        (lambda s: s.final_times, AttributeError),
        (lambda s: 1 + "m", TypeError),
    ],
)
def test_functions_that_are_wrong_everywhere_end_the_sweep(mistake: Any, kind: type[Exception]) -> None:
    with pytest.raises(kind):
        go.sweep(stiff, {"k": [1.0, 2.0]}, outputs={"none": mistake}, mesh="2x3", executor="serial")


@pytest.mark.slow
def test_refined_sweeps() -> None:
    found = go.sweep(rest_to_rest, {"duration": [2.2, 2.1]}, tol=1e-8, executor="serial")
    assert all(len(solution.structure) == 3 for solution in found.solutions)


def test_xarray(swept: go.Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(go.GncOptError, match="xarray is not installed"):
        swept.to_xarray()
    made = SimpleNamespace(Dataset=lambda data, coords: (data, coords))
    monkeypatch.setitem(sys.modules, "xarray", made)
    data, coordinates = swept.to_xarray()
    assert list(coordinates) == ["target", "k"] and data["start"][0] == ("target", "k")
    np.testing.assert_array_equal(data["objective"][1], swept.objective)
    assert data["ending"][1].tolist() == [["optimal"] * 3] * 2


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((stiff(), GRID), "needs a function"),
        ((stiff, [1.0]), "the grid of sweep"),
        ((stiff, {}), "grid of sweep.. is empty"),
        ((stiff, {"k": []}), "give finite numbers"),
        ((stiff, {"k": [np.inf]}), "give finite numbers"),
        ((stiff, {"a b": [1.0]}), "cannot be the name"),
        (
            (stiff, {"k": [1.0], "wind": [0.0]}),
            "function of sweep.. takes .*target.* but the grid has k, wind .*'wind'",
        ),
        ((lambda mass: stiff(mass), {"k": [1.0]}), "takes .mass., but the grid has k"),
        ((lambda k: k, {"k": [1.0]}), ""),
    ],
)
def test_mistakes_get_a_sentence(arguments: Any, message: str) -> None:
    if message:
        with pytest.raises(go.ArgumentError, match=message):
            go.sweep(*arguments, executor="serial")
    else:
        assert "return the problem" in go.sweep(*arguments, executor="serial").endings[0]
    with pytest.raises(go.ArgumentError, match="output 'x' of sweep"):
        go.sweep(stiff, GRID, outputs={"x": 1.0}, executor="serial")  # type: ignore[dict-item]
