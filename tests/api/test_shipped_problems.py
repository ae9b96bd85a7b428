"""The problems that come with gnc_opt: listed and run by the command line, and installed with the package."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import gnc_opt as go
from gnc_opt import problem_files_and_examples as examples
from gnc_opt.cli import ExitCode, main
from problems.classics import minimum_fuel

ROOT = Path(__file__).parents[2]


def names() -> set[str]:
    files = {
        p.stem
        for p in (ROOT / "problems").glob("*/*.py")
        if p.stem != "__main__" and "example_main(build, REFERENCE" in p.read_text("utf-8")
    }
    return files | {p.parent.name for p in (ROOT / "problems").glob("*/__main__.py")}


def test_every_problem_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["examples"]) == ExitCode.OK
    *listed, _, folder = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in listed} == names()
    assert all(len(line.split()) > 3 for line in listed), "each has a title"
    assert (Path(folder.partition(": ")[2]) / "classics" / "zermelo.py").is_file()


def test_one_is_run_with_its_own_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.json"
    assert main(["examples", "minimum_fuel", "--json", str(out)]) == 0
    assert "pass" in capsys.readouterr().out
    told = json.loads(out.read_text())
    assert told["reference"]["agrees"]
    assert abs(told["objective"] - minimum_fuel.REFERENCE.value) < 1e-8


def test_an_unknown_one_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["examples", "zermello"]) == ExitCode.BAD_INPUT
    assert "zermelo" in capsys.readouterr().err
    with pytest.raises(go.UnknownNameError):
        examples.find_example("")


def test_a_package_without_its_problems_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(examples, "_HOLDERS", (tmp_path,))
    with pytest.raises(go.GncOptError, match="install gnc_opt again"):
        examples.list_examples()


def test_they_are_installed_with_the_package() -> None:
    """What the build backend would pack, without building."""
    pytest.importorskip("setuptools")
    program = (
        "import sys; sys.argv = ['setup.py', '--name']; import setuptools; kept = {};"
        "setuptools.setup = lambda **options: kept.update(options);"
        "exec(open('setup.py').read());"
        "print(*kept['packages'], sep='\\n'); print(kept['package_dir'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    *packages, folders = done.stdout.split("\n")[:-1]
    shipped = {name.removeprefix("gnc_opt.shipped.") for name in packages if ".shipped." in name}
    assert shipped == {
        "problems",
        *(f"problems.{p.parent.name}" for p in (ROOT / "problems").glob("*/__init__.py")),
    }
    assert {"gnc_opt", "gnc_opt.control"} <= set(packages)
    assert folders == "{'gnc_opt.shipped.problems': 'problems'}"
