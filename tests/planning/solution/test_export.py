"""Solutions, runs and campaigns as tables and files: their numbers, under their names, with their units."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import scipy
from testing.loops import scheduled
from testing.models import one_phase

import gnc_opt as go
from gnc_opt.errors import GncOptError
from gnc_opt.simulation import Uniform


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    """A cart in the plane and its mass, 1 s, held at one end of a bound."""
    model = go.Model("cart")
    r, v = model.state("r", 2, unit="m"), model.state("v", 2, unit="m/s")
    m = model.state("m", unit="kg")
    a = model.control("a", 2, unit="m/s^2")
    model.ode({r: v, v: a, m: -1.0})
    problem, leg = one_phase("plane", model, 0.0, 1.0)
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


@pytest.mark.slow
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


def test_a_table_in_csv_is_a_guess(solution: go.Solution, tmp_path: Path) -> None:
    """What is written is the shortest decimal of each number: it is read digit for digit."""
    path = solution.export(tmp_path / "leg.csv", times=[0.0, 0.1, 1.0])
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    columns = {name: [float(row[name]) for row in rows] for name in ("time", "r[1]", "lam_v[0]")}
    assert columns["time"] == [0.0, 0.1, 1.0]
    assert columns["r[1]"] == solution.state("r")([0.0, 0.1, 1.0])[1].tolist()
    assert columns["lam_v[0]"] == solution.costate("v")([0.0, 0.1, 1.0])[0].tolist()


def test_json_holds_every_number_with_its_unit(solution: go.Solution, tmp_path: Path) -> None:
    told = json.loads(solution.export(tmp_path / "leg.json", times=[0.3]).read_text())
    assert told["phase"] == "leg" and told["time"] == [0.3]
    assert told["columns"]["a[0]"] == [solution.phase().applied([0.3])[0, 0]]
    assert told["units"]["a[0]"] == "m/s^2" and told["units"]["time"] == "s"


def test_matlab_reads_matrices_by_name(solution: go.Solution, tmp_path: Path) -> None:
    path = solution.export(tmp_path / "leg.mat", "leg", [0.0, 0.5])
    read = scipy.io.loadmat(path)
    assert read["time"].shape == (2, 1) and read["r"].shape == (2, 2)
    assert read["r"].T.tolist() == solution.state("r")([0.0, 0.5]).tolist()
    assert read["units"]["lam_m"][0, 0][0] == "1/(kg)"


def test_other_kinds_of_files_are_refused(solution: go.Solution, tmp_path: Path) -> None:
    with pytest.raises(go.ArgumentError, match=r"\.csv, \.json, \.mat"):
        solution.export(tmp_path / "leg.xlsx")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def campaign() -> go.Campaign:
    """A point that drifts in the plane, three runs; nothing pushes it, so its ends are known."""
    model = go.Model("drift")
    r, u = model.state("r", 2, unit="m"), model.control("u", unit="m/s")
    speed = model.parameter("speed", 1.0, unit="m/s")
    model.ode({r: ca.vertcat(speed, u)})
    loop = go.ClosedLoop(model, scheduled(model, lambda t: np.full((1, t.size), 0.25)), dt=0.5)
    return go.monte_carlo(
        loop,
        3,
        x0={"r": [0.0, 0.0]},
        tf=2.0,
        seed=3,
        dispersions={"plant.speed": Uniform(-0.5, 0.5)},
        executor="serial",
    )


def test_a_row_per_run(campaign: go.Campaign) -> None:
    pytest.importorskip("pandas")
    frame = campaign.to_pandas()
    assert frame.index.tolist() == [0, 1, 2] and frame.index.name == "run"
    assert frame["outcome"].tolist() == ["ok"] * 3
    np.testing.assert_allclose(frame["final.r[0]"], 2.0 * frame["plant.speed"], rtol=1e-12)
    np.testing.assert_allclose(frame["effort(u)"], 0.5, rtol=1e-12)
    assert frame["plant.speed"].nunique() == 3
    assert frame.attrs["units"]["plant.speed"] == "m/s" and frame.attrs["seed"] == 3


def test_a_row_per_control_step(campaign: go.Campaign) -> None:
    pytest.importorskip("xarray")
    run = campaign.rerun(1)
    data = run.to_xarray()
    assert data.sizes == {"time": 5, "r_component": 2, "measured.r_component": 2}
    np.testing.assert_allclose(data["r"][1], 0.25 * data["time"], rtol=1e-12)
    assert data["command.u"].values[:4].tolist() == [0.25] * 4
    assert np.isnan(data["command.u"].values[4]), "nothing is commanded at the end"
    assert data["measured.r"].attrs["units"] == "m" and data.attrs["outcome"] == "ok"


def test_files_of_runs_and_campaigns(campaign: go.Campaign, tmp_path: Path) -> None:
    run = campaign.rerun(2)
    lines = run.export(tmp_path / "run.csv").read_text().splitlines()
    assert lines[0] == "time,r[0],r[1],measured.r[0],measured.r[1],command.u,applied.u"
    assert lines[-1].endswith(",,,,"), "no number, an empty field"
    told = json.loads(campaign.export(tmp_path / "campaign.json").read_text())
    assert told["columns"]["outcome"] == ["ok"] * 3 and told["run"] == [0, 1, 2]
    assert told["columns"]["plant.speed"] == campaign.parameter("plant.speed")[0].tolist()
    read = scipy.io.loadmat(campaign.export(tmp_path / "campaign.mat"))
    assert read["final_r"].T.tolist() == campaign.state("r").tolist()
    assert [str(word[0]) for word in read["outcome"][:, 0]] == ["ok"] * 3
