"""What the README shows is what happens."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from gnc_opt.cli import ExitCode, _parser

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")

NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_example_prints_what_the_readme_says() -> None:
    """Every word, and every number that does not depend on the machine."""
    code = blocks("python")[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 22
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    shown, printed = blocks("text")[0].splitlines(), stream.getvalue().splitlines()
    assert [NUMBER.sub("#", line) for line in printed] == [NUMBER.sub("#", line) for line in shown]
    # The solver's tolerance is 1e-9, scaled; the optimum is exactly 2 s.
    objective = re.search(r"objective (\S+) ", printed[0])
    assert objective and float(objective[1]) == pytest.approx(2.0, abs=1e-7)
    assert printed[-1] == shown[-1] == "0.9550 1.0000 -1.0000"


def test_second_example_prints_what_the_readme_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From plan to statistics; the seed fixes every number that is shown, up to rounding."""
    monkeypatch.chdir(tmp_path)
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        exec(compile(blocks("python")[1], "README.md", "exec"), {"__name__": "readme"})
    shown, printed = blocks("text")[1].splitlines(), stream.getvalue().splitlines()
    assert [NUMBER.sub("#", line) for line in printed] == [NUMBER.sub("#", line) for line in shown]
    for line, other in zip(printed, shown, strict=True):
        if "integration" not in line:  # an error estimate at the level of rounding
            numbers = [[float(m.group()) for m in NUMBER.finditer(text)] for text in (line, other)]
            assert numbers[0] == pytest.approx(numbers[1], rel=2e-2)
    assert sorted(path.suffix for path in (tmp_path / "flight_code").iterdir()) == [".c", ".c", ".h"]


def test_exit_codes_are_those_of_the_program() -> None:
    listed = {int(code) for code in re.findall(r"^\| (\d+) \|", README, re.MULTILINE)}
    assert listed == {int(code) for code in ExitCode}


def test_usage_lists_the_options_of_the_program() -> None:
    usage = next(block for block in blocks("text") if block.startswith("gnc-opt solve"))
    actions = _parser()._subparsers._group_actions[0].choices["solve"]._actions  # type: ignore[union-attr]
    options = {s for action in actions for s in action.option_strings if s.startswith("--")} - {"--help"}
    assert set(re.findall(r"--[a-z-]+", usage)) == options


def test_files_and_folders_that_are_named_exist() -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    layout = [
        name
        for row in re.findall(r"^\| (`.*?) \|", README, re.MULTILINE)
        for name in re.findall(r"`(\S+?)`", row)
    ]
    named = links + [
        n if n.startswith(("gnc_opt", "problems", "benchmarks", "tests")) else f"gnc_opt/{n}" for n in layout
    ]
    assert len(named) > 12
    for name in [*named, "problems/rendezvous", ".ci/run", "LICENSE", "CHANGELOG.md"]:
        assert (ROOT / name).exists(), name


def test_version_is_the_same_everywhere() -> None:
    versions = {
        "pyproject.toml": r'^version = "(.*)"',
        "CITATION.cff": r"^version: (.*)",
        "CHANGELOG.md": r"^## (\S+)",
    }
    found = {
        f: re.search(p, (ROOT / f).read_text(encoding="utf-8"), re.MULTILINE)[1] for f, p in versions.items()
    }  # type: ignore[index]
    assert len(set(found.values())) == 1, found
