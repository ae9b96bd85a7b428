"""Solutions as tables of other packages: the numbers of the solution, under its names, with its units."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.errors import GncOptError


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    """A cart in the plane and its mass, 1 s, held at one end of a bound."""
    model = go.Model("cart")
    r, v = model.state("r", 2, unit="m"), model.state("v", 2, unit="m/s")
    m = model.state("m", unit="kg")
    a = model.control("a", 2, unit="m/s^2")
    model.ode({r: v, v: a, m: -1.0})
    problem = go.Problem("plane")
    leg = problem.phase("leg", model)
    leg.time(0.0, 1.0)
    leg.initial(r=[0.0, 0.0], v=0.0, m=5.0)
    leg.final(r=[1.0, 2.0], v=0.0)
    problem.minimize(leg.integral(a[0] ** 2 + a[1] ** 2))
    return go.solve(problem, mesh="3x4", tol=None)


def test_table(solution: go.Solution) -> None:
    pytest.importorskip("pandas")
    frame = solution.to_pandas()
    assert list(frame.columns) == [
        *("r[0]", "r[1]", "v[0]", "v[1]", "m", "a[0]", "a[1]"),
        *("lam_r[0]", "lam_r[1]", "lam_v[0]", "lam_v[1]", "lam_m"),
    ]
    t = frame.index.to_numpy()
    assert t.size == 31 and t[0] == 0.0 and t[-1] == 1.0
    # Rest to rest: r = d (3 t^2 - 2 t^3), a = d (6 - 12 t), lambda_v = -2 a, lambda_r = -d(lambda_v)/dt = -24 d.
    np.testing.assert_allclose(frame["r[1]"], 2 * (3 * t**2 - 2 * t**3), atol=1e-9)
    np.testing.assert_allclose(frame["a[0]"], 6 - 12 * t, atol=1e-7)
    np.testing.assert_allclose(frame["lam_r[0]"], -24.0, rtol=1e-7)
    assert frame.index.name == "time"
    assert frame.attrs["units"]["v[1]"] == "m/s" and frame.attrs["units"]["lam_m"] == "1/(kg)"


def test_dataset(solution: go.Solution) -> None:
    pytest.importorskip("xarray")
    t = np.array([0.0, 0.25, 1.0])
    data = solution.to_xarray("leg", t)
    assert data["r"].dims == ("r_component", "time") and data["m"].dims == ("time",)
    np.testing.assert_allclose(data["r"].sel(time=0.25), np.array([1.0, 2.0]) * (3 / 16 - 2 / 64), atol=1e-9)
    np.testing.assert_allclose(data["m"], 5 - t, atol=1e-10)
    assert data["a"].attrs["units"] == "m/s^2" and data["time"].attrs["units"] == "s"
    assert data.attrs["objective"] == solution.objective and data.attrs["problem"] == "plane"


def test_dataset_survives_being_a_dict(solution: go.Solution) -> None:
    xarray = pytest.importorskip("xarray")
    data = solution.to_xarray()
    assert xarray.Dataset.from_dict(data.to_dict()).identical(data)


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_missing_package_is_named(solution: go.Solution, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(GncOptError, match=rf"{name} is not installed: pip install 'gnc_opt\[data\]'"):
        getattr(solution, f"to_{name}")()


def test_times_outside_the_phase_are_refused(solution: go.Solution) -> None:
    pytest.importorskip("pandas")
    with pytest.raises(GncOptError, match="outside the span"):
        solution.to_pandas(times=[0.5, 1.5])


def test_repr_is_one_line(solution: go.Solution) -> None:
    assert (
        repr(solution) == f"Solution('plane', optimal, objective={solution.objective:.10g}, phases=['leg'])"
    )
