"""What `gnc-opt new` writes solves as it stands, is clean, and replaces nothing."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import gnc_opt as go
from gnc_opt import cli, templates
from gnc_opt.templates import KINDS


def run(*arguments: Any) -> int:
    """The exit code, also where argparse leaves by SystemExit."""
    try:
        return cli.main([str(a) for a in arguments])
    except SystemExit as leaving:
        return int(leaving.code or 0)


def template(kind: str) -> Any:
    return import_module(f"gnc_opt.templates.{kind.replace('-', '_')}")


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_solves_with_a_verdict_that_is_ok(kind: str) -> None:
    solution = go.solve(template(kind).build(), mesh=template(kind).MESH, tol=1e-6)
    assert go.verify(solution).ok, str(solution)


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"landing"}))  # whose switch no mesh can place
def test_a_smooth_template_is_ok_on_its_own_mesh(kind: str) -> None:
    solution = go.solve(template(kind).build(), mesh=template(kind).MESH, tol=None)
    assert go.verify(solution).ok, str(go.verify(solution))


def test_two_phase_costs_what_the_spline_costs() -> None:
    """Least acceleration through a waypoint is a clamped cubic spline; its cost, minimised over the time of passage."""
    waypoint, goal, duration = np.array([1.0, 1.0]), np.array([3.0, 0.0]), 4.0

    def cost(passage: float) -> float:
        first, second = passage, duration - passage
        # per phase, int a^2 = 12 |d|^2/T^3 - 12 d.(v0+v1)/T^2 + 4 (|v0|^2 + v0.v1 + |v1|^2)/T; minimal over v there
        ahead = goal - waypoint
        v = 1.5 * (waypoint / first**2 + ahead / second**2) / (1 / first + 1 / second)
        legs = ((waypoint, first), (ahead, second))
        return float(sum(12 * d @ d / T**3 - 12 * d @ v / T**2 + 4 * v @ v / T for d, T in legs))

    best = minimize_scalar(cost, bounds=(0.5, 3.5), method="bounded").fun
    module = template("two-phase")
    assert go.solve(module.build(), mesh=module.MESH, tol=None).objective == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_new_writes_the_template_and_check_accepts_it(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("new", tmp_path / "mine", "--kind", kind) == 0
    assert f"gnc-opt solve {tmp_path / 'mine.py'}" in capsys.readouterr().out
    source = Path(template(kind).__file__)
    assert (tmp_path / "mine.py").read_text(encoding="utf-8") == source.read_text(encoding="utf-8")
    assert run("check", tmp_path / "mine.py") == 0


def test_one_phase_is_the_default(tmp_path: Path) -> None:
    assert run("new", tmp_path / "mine.py") == 0
    assert (tmp_path / "mine.py").read_text(encoding="utf-8") == templates.read_template_text("one-phase")


def test_new_replaces_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "mine.py"
    kept.write_text("my work")
    for name in ("mine", "mine.py"):
        assert run("new", tmp_path / name) == cli.ExitCode.BAD_INPUT
        assert "exists already" in capsys.readouterr().err
    assert kept.read_text() == "my work"


@pytest.mark.parametrize(
    ("name", "complaint"),
    [("", "names no file"), (".py", "names no file"), ("nowhere/mine", "does not exist")],
)
def test_new_refuses_what_is_no_place_for_a_file(
    name: str,
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("new", name) == cli.ExitCode.BAD_INPUT
    told = capsys.readouterr().err
    assert complaint in told and told.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_new_knows_no_other_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("new", tmp_path / "mine", "--kind", "three-phase") == cli.ExitCode.BAD_INPUT
    assert "three-phase" in capsys.readouterr().err


@pytest.mark.skipif(
    not shutil.which("ruff", path=Path(sys.executable).parent), reason="needs ruff, of the extra dev"
)
def test_what_is_written_is_clean_by_the_defaults_of_ruff(tmp_path: Path) -> None:
    for kind in KINDS:
        run("new", tmp_path / kind, "--kind", kind)
    ruff = str(Path(sys.executable).parent / "ruff")
    for action in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [ruff, *action, "--isolated", "--no-cache", tmp_path], capture_output=True, check=False
        )
        assert done.returncode == 0, done.stdout.decode()
