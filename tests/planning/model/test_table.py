"""Tables: values against SciPy's interpolants, derivatives by differences, what happens outside, files, messages."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.interpolate as reference
from testing.models import dynamics, one_phase

import gnc_opt as go
from gnc_opt.report import summary_dict

RNG = np.random.default_rng(3)
X, Y, Z = (np.sort(RNG.uniform(-2.0, 5.0, n)) for n in (9, 6, 5))
VALUES = RNG.normal(size=(9, 6, 5))
ONE = VALUES[:, 0, 0]
METHODS = ("bspline", "linear", "pchip")


def inside(grid: Any, n: int = 101) -> Any:
    return np.linspace(grid[0], grid[-1], n)


@pytest.mark.parametrize(
    "method, right",
    [
        ("bspline", reference.make_interp_spline(X, ONE, 3)),
        ("linear", lambda q: np.interp(q, X, ONE)),
        ("pchip", reference.PchipInterpolator(X, ONE)),
    ],
)
def test_one_dimension_is_scipys(method: Any, right: Any) -> None:
    np.testing.assert_allclose(go.table(X, ONE, method=method)(inside(X)), right(inside(X)), atol=1e-13)


def test_two_dimensions_are_one_after_the_other() -> None:
    first = reference.make_interp_spline(X, VALUES[:, :, 0], 3)(inside(X))
    right = [reference.make_interp_spline(Y, row, 3)(y) for row, y in zip(first, inside(Y), strict=True)]
    np.testing.assert_allclose(go.table([X, Y], VALUES[:, :, 0])(inside(X), inside(Y)), right, atol=1e-12)


def test_three_dimensions_linear() -> None:
    points = inside(X), inside(Y), inside(Z)
    right = reference.RegularGridInterpolator((X, Y, Z), VALUES)(np.stack(points, axis=1))
    np.testing.assert_allclose(go.table([X, Y, Z], VALUES, method="linear")(*points), right, atol=1e-13)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_goes_through_its_points_in_three_dimensions(method: Any) -> None:
    grid = np.meshgrid(X, Y, Z, indexing="ij")
    np.testing.assert_allclose(go.table([X, Y, Z], VALUES, method=method)(*grid), VALUES, atol=1e-12)


@pytest.mark.parametrize("points, power", [(2, 1), (3, 2), (4, 3)])
def test_few_points_give_the_polynomial_through_them(points: int, power: int) -> None:
    x = X[:points]
    np.testing.assert_allclose(go.table(x, x**power)(inside(x)), inside(x) ** power, atol=1e-11)


@pytest.mark.parametrize("outside", ["linear", "hold", "error"])
def test_derivatives_of_expressions_are_those_of_the_spline(outside: Any) -> None:
    s = ca.SX.sym("s")
    value = go.table(X, ONE, outside=outside)(s)
    function = ca.Function("f", [s], [value, ca.gradient(value, s), ca.hessian(value, s)[0]])
    spline = reference.make_interp_spline(X, ONE, 3)
    for order, found in enumerate(function(inside(X)[None, 1:-1])):
        np.testing.assert_allclose(found.full()[0], spline(inside(X)[1:-1], order), atol=1e-11)


@pytest.mark.parametrize("method", METHODS)
def test_linear_continuation(method: Any) -> None:
    """Beyond its end the table is its tangent there, in two dimensions along each axis."""
    one = go.table(X, ONE, method=method)
    end, step = X[-1], 1e-6
    slope = (one(end) - one(end - step)) / step
    assert one(end + 3.0) == pytest.approx(one(end) + 3.0 * slope, abs=1e-4)
    two = go.table([X, Y], VALUES[:, :, 0], method=method)
    slope = (two(0.3, Y[0] + step) - two(0.3, Y[0])) / step
    assert two(0.3, Y[0] - 2.0) == pytest.approx(two(0.3, Y[0]) - 2.0 * slope, abs=1e-4)


def test_hold_and_refusal_outside() -> None:
    held = go.table([X, Y], VALUES[:, :, 0], outside="hold")
    assert held(1e3, 0.5) == pytest.approx(held(X[-1], 0.5), abs=1e-14)
    assert held(-1e3, 1e3) == pytest.approx(VALUES[0, -1, 0], abs=1e-13)
    strict = go.table(X, ONE, outside="error", name="thrust")
    with pytest.raises(go.ArgumentError, match="argument 1 of table 'thrust' is 7, outside of its range"):
        strict([0.0, 7.0])
    s = ca.SX.sym("s")  # an expression goes on linearly: a solver's iterates must not meet NaN
    assert float(ca.Function("f", [s], [strict(s)])(7.0)) == pytest.approx(go.table(X, ONE)(7.0), abs=1e-12)


@pytest.mark.parametrize("outside", ["linear", "hold"])
def test_what_is_not_a_number_stays_so(outside: Any) -> None:
    table = go.table([X, Y], VALUES[:, :, 0], outside=outside)
    assert np.isnan(table(np.nan, 0.5)) and np.isnan(table(0.5, np.nan))


def test_columns_of_expressions_and_arrays_that_broadcast() -> None:
    table = go.table([X, Y], VALUES[:, :, 0])
    s = ca.SX.sym("s", 2)
    function = ca.Function("f", [s], [table(s, 0.5)])
    np.testing.assert_allclose(function([0.1, 0.2]).full()[:, 0], table([0.1, 0.2], 0.5), atol=1e-13)
    assert table([[0.1], [0.2]], [0.3, 0.4, 0.5]).shape == (2, 3)
    assert isinstance(table(0.1, 0.5), float)


def test_csv_of_a_grid_in_any_order(tmp_path: Path) -> None:
    rows = [(x, y, v) for x, row in zip(X, VALUES[:, :, 0], strict=True) for y, v in zip(Y, row, strict=True)]
    text = "mach, altitude, thrust\n" + "\n".join(f"{x!r},{y!r},{v!r}" for x, y, v in reversed(rows))
    (tmp_path / "thrust.csv").write_text(text.replace("np.float64(", "").replace(")", ""))
    table = go.table_from_csv(tmp_path / "thrust.csv", ["mach", "altitude"], "thrust", outside="hold")
    assert table.name == "thrust" and table.outside == "hold"
    np.testing.assert_array_equal(table.values, VALUES[:, :, 0])


@pytest.mark.parametrize(
    "text, message",
    [
        ("mach,cd\n0,1\n1,2\n", "has no column 'drag': known: mach, cd"),
        ("mach,drag\n0,1\n1,many\n", "line 3 of .* has no number in column 'drag'"),
        ("mach,drag\n0,1\n0,2\n", "2 rows of .* are not the 1 points of a full grid of mach"),
        ("mach,drag\n", "has no rows below its first one"),
    ],
)
def test_csv_that_is_no_table(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "drag.csv").write_text(text)
    with pytest.raises(go.ArgumentError, match=message):
        go.table_from_csv(tmp_path / "drag.csv", "mach", "drag")


class DataArray(SimpleNamespace):
    """What `table` asks of an xarray.DataArray."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        return self.data


def test_xarray() -> None:
    data = DataArray(data=VALUES[:, :, 0], dims=("mach", "h"), coords={"h": Y, "mach": X}, name="thrust")
    table = go.table(data)
    assert table.name == "thrust" and repr(table) == "Table('thrust': 9 x 6 values, bspline, linear outside)"
    assert table(X[2], Y[3]) == pytest.approx(VALUES[2, 3, 0], abs=1e-13)
    with pytest.raises(go.ArgumentError, match="a DataArray has its own"):
        go.table(data, VALUES)
    bare = DataArray(data=VALUES[:, :, 0], dims=("mach", "h"), coords={"mach": X}, name="thrust")
    with pytest.raises(go.ArgumentError, match="without coordinates along 'h'"):
        go.table(bare)


@pytest.mark.parametrize(
    "x, values, options, message",
    [
        ([0, 2, 1], [1, 2, 3], {}, "grid 1 of table 'drag' does not increase"),
        ([0, 1], [1, 2, 3], {}, "as many points as values"),
        ([0], [1], {}, "two or more"),
        ([0, 1], [1, np.nan], {}, r"no finite value at \(1\)"),
        ([0, 1], [[1, 2], [3, 4]], {}, "one grid per axis"),
        ([0, 1], None, {}, "got no values"),
        ([0, 1], [1, 2], {"method": "cubic"}, "has no method 'cubic'"),
        ([0, 1], [1, 2], {"outside": "holt"}, "did you mean 'hold'"),
        ([0, 1], ["a", "b"], {}, "not a number"),
        (np.arange(300000), np.zeros(300000), {}, "thin it out"),
    ],
)
def test_mistakes_get_a_sentence(x: Any, values: Any, options: Any, message: str) -> None:
    with pytest.raises(go.ArgumentError, match=message):
        go.table(x, values, name="drag", **options)


def test_calls_that_cannot_be_meant() -> None:
    table = go.table([X, Y], VALUES[:, :, 0], name="thrust")
    with pytest.raises(go.ArgumentError, match="has 2 axes but 1 arguments"):
        table(0.5)
    with pytest.raises(go.ArgumentError, match="shapes"):
        table([1, 2, 3], [1, 2])
    with pytest.raises(go.ModelError, match="have 2, 3 components"):
        table(ca.SX.sym("a", 2), ca.SX.sym("b", 3))
    with pytest.raises(go.ModelError, match="give SX expressions or numbers"):
        table(ca.MX.sym("a"), 1.0)
    with pytest.raises(go.ArgumentError, match="not a number"):
        table("high", 1.0)


def hop(method: Any = "bspline", outside: Any = "linear", top: float = 0.5) -> go.Problem:
    """x'' = u from 0 to 1 in 1 s, paying for the table's value of x, which ends at ``top``."""
    price = go.table(
        np.linspace(0.0, top, 6), np.linspace(0.0, top, 6) ** 2, method=method, outside=outside, name="price"
    )
    model, x, _v, u = dynamics("hop", "x v", "u", lambda x, v, u: {x: v, v: u})
    problem, leg = one_phase("hop", model, 0.0, 1.0)
    leg.initial(x=0.0, v=0.0)
    leg.final(x=1.0, v=0.0)
    problem.minimize(leg.integral(u**2 + price(x)))
    return problem


def test_a_solution_outside_of_its_table_is_reported() -> None:
    with pytest.warns(go.ProblemWarning, match="guess leaves a table .*'price' evaluated outside"):
        solution = go.solve(hop(), tol=None)
    (found,) = solution.outside_tables()
    assert found.value == pytest.approx(1.0, abs=1e-6) and found.time == pytest.approx(1.0)
    assert found.span[0] == pytest.approx(0.5, abs=0.05)  # x(0.5) = 0.5 but for the small price
    assert "table        'price' evaluated outside at t = 0.5" in str(solution)
    assert summary_dict(solution)["outside_tables"] == [str(found)]
    assert go.verify(solution)["limits"].value == pytest.approx(
        1.0, abs=1e-5
    )  # as far outside as the table is long


def test_a_solution_inside_of_its_table_is_not(recwarn: pytest.WarningsRecorder) -> None:
    solution = go.solve(hop(top=1.0), tol=None)
    assert solution.outside_tables() == [] and "outside" not in str(solution) and not recwarn.list


def test_a_table_that_refuses_what_is_outside() -> None:
    with pytest.raises(go.ProblemError, match=r"the guess leaves a table .*give another guess"):
        hop(outside="error").check()
    inside = hop(outside="error", top=1.0)
    inside.check()
    with pytest.raises(go.ProblemError, match=r"the guess leaves a table .*give another guess"):
        inside.with_guess(x=2.0).check()


def test_kinks_of_linear_tables_are_reported() -> None:
    with pytest.warns(go.ProblemWarning, match="table 'price' in phase 'leg' .* is linear and has a kink"):
        hop("linear", top=1.0).check()


def test_the_table_of_another_problem_of_the_model_is_not_this_ones() -> None:
    problem = hop(top=1.0)
    model = problem.phases["leg"].model
    go.table([0.0, 0.1], [1.0, 2.0])(model.symbol("x"))  # looked up, and used nowhere
    assert go.solve(problem, tol=None).outside_tables() == []
