"""What `gnc-opt new` writes solves as it stands, is clean, and replaces nothing."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

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


OPTIMA = {"one-phase": 1.52307917, "landing": 974.411817, "attitude": 0.192738792, "two-phase": 4.98206264}
"""By `scipy.integrate.solve_bvp`; free fall, then full thrust (rocket equation); collocation with a tolerance of 1e-9;
the clamped cubic spline, minimised over the time of passage."""


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_solves_with_a_verdict_that_is_ok(kind: str) -> None:
    solution = go.solve(template(kind).build(), mesh=template(kind).MESH, tol=1e-6)
    assert go.verify(solution).ok, str(solution)
    assert solution.objective == pytest.approx(OPTIMA[kind], rel=1e-6)


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
