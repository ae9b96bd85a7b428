"""The command line on small problem files: output, files, exit codes, bad input."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import gnc_opt as go
from gnc_opt import cli
from gnc_opt.errors import GncOptError
from gnc_opt.problem_files_and_examples import ProblemFileError, load_problem_file, parse_build_option

ROOT = Path(go.__file__).parents[1]

CART = """
import gnc_opt as go

MESH = "10x3"

def build(far=1.0, limits=(-1.0, 1.0), name="cart", wrong=None):
    model = go.Model("double integrator")
    q = model.state("q", unit="m")
    v = model.state("v", unit="m/s")
    a = model.control("a", unit="m/s^2")
    model.ode({q: v, v: a})
    problem = go.Problem(name)
    leg = problem.phase("leg", model)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(q=far, v=0.0)
    leg.final(q=0.0, v=0.0)
    leg.bounds(a=tuple(limits))
    if wrong == "name":
        leg.bounds(aa=(-1.0, 1.0))  # line 19
    if wrong == "zero":
        far / 0  # line 21
    if wrong == "value":
        leg.initial(q=float("nan"))
    problem.minimize(leg.final_time)
    return None if wrong == "nothing" else problem
"""


@pytest.fixture
def cart(tmp_path: Path) -> Path:
    path = tmp_path / "cart.py"
    path.write_text(CART)
    return path


def run(*arguments: Any) -> int:
    """The exit code, also where argparse leaves by SystemExit."""
    try:
        return cli.main([str(a) for a in arguments])
    except SystemExit as leaving:
        return int(leaving.code or 0)


def complaint(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error; nothing on standard output, no traceback."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("gnc-opt: ") and err.count("\n") == 1, err
    return err


def test_solve_prints_summary_and_verdict(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--tol", "none") == 0
    out, err = capsys.readouterr()
    assert re.match(r"cart: solved \(optimal\), objective 2(\.00000\d*)? s ± \S+ \(minimised\)", out)
    assert "10 segments, degree 3, Legendre-Gauss" in out  # MESH of the file
    assert "verdict: ok" in out
    assert err.count("\n") == 1 and "iteration" in err


def test_conditions_prints_every_condition(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--tol", "none", "--conditions") == 0
    out = capsys.readouterr().out
    first = ("dynamics", "limits", "boundary conditions", "cost", "stationarity", "active set")
    for name in (*first, "minimum principle", "kinks", "second order", "switching times"):
        assert re.search(rf"^ *{name} +PASS", out, re.MULTILINE), name


@pytest.mark.usefixtures("blank_figures")
def test_solve_writes_json_and_report(cart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target, folder = tmp_path / "out.json", tmp_path / "report"
    assert run("solve", cart, "--json", target, "--report", folder, "--set", "name=probe") == 0
    told = json.loads(target.read_text())
    assert told["problem"] == "probe"
    assert told["verdict"]["ok"] is True
    assert told["objective"] == pytest.approx(2.0, abs=1e-7)
    assert {"report.html", "summary.json", "solution.npz", "states.svg"} <= {p.name for p in folder.iterdir()}
    assert f"report: {folder / 'report.html'}" in capsys.readouterr().out
    assert f"gnc-opt solve {cart} --json {target}" in (folder / "report.html").read_text(encoding="utf-8")
    assert go.load(folder / "solution.npz").objective == told["objective"]


def test_json_to_standard_output_is_nothing_but_json(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--json", "-") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["status"] == "optimal"
    assert "cart: refined (converged)" in err


def test_options_reach_the_solve(cart: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    options = [
        "--set", "far=4", "--set", "limits=[-2, 1]", "--mesh", "6x4", "--scheme", "lgr", "--solver-tol",
        "1e-7", "--tol", "none",
    ]  # fmt: skip
    assert run("solve", cart, *options, "--no-verify", "--quiet", "--json", target) == 0
    told = json.loads(target.read_text())
    assert (told["mesh"], told["scheme"], told["verdict"]) == ("6x4", "LGR", None)
    assert "tolerance=1e-07" in told["provenance"]["options"]
    # Rest to rest over d, accelerating by a, braking by b: t = sqrt(2 d (a + b) / (a b)), here sqrt(12).
    # The switch, at one third, is a boundary of 6 segments. The solver's tolerance leaves 1e-6.
    assert told["objective"] == pytest.approx(12**0.5, abs=1e-5)


@pytest.mark.usefixtures("blank_figures")
def test_quiet_says_nothing(cart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--quiet", "--report", tmp_path / "report") == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("blank_figures")
def test_the_view_of_the_problem_file_is_shown(
    cart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cart.write_text(CART + "\nfrom gnc_opt.plot import View\nVIEW = View('q')\n")
    assert run("solve", cart, "--quiet", "--no-verify", "--report", tmp_path) == 0
    assert '<section id="motion">' in (tmp_path / "report.html").read_text()
    cart.write_text(CART + "\nVIEW = 'q'\n")
    assert run("solve", cart, "--quiet", "--report", tmp_path) == 2
    assert "VIEW is a str, not a View" in capsys.readouterr().err


def test_exit_code_of_a_verdict_that_fails(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--mesh", "5x3", "--tol", "none") == 1
    out = capsys.readouterr().out
    assert "NOT ok" in out
    assert run("solve", cart, "--mesh", "5x3", "--tol", "none", "--exit-zero") == 0
    assert run("solve", cart, "--mesh", "5x3", "--tol", "none", "--no-verify") == 0


def test_answers_are_refined_by_default(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--mesh", "5x3") == 0
    out = capsys.readouterr().out
    assert "cart: refined (converged)" in out and "every condition passes" in out
    assert "tolerance 1e-08" in out


def test_exit_code_of_a_problem_without_solution(
    cart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "out.json"
    assert run("solve", cart, "--set", "far=100", "--json", target, "--exit-zero") == 3
    assert "cart: NOT SOLVED (infeasible)" in capsys.readouterr().out
    assert json.loads(target.read_text())["violations"]


def test_options_of_refining_are_passed_on(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("solve", cart, "--tol", "1e-5", "--fast") == 0
    out = capsys.readouterr().out
    assert "refined (unchecked)" in out and "tolerance 1e-05" in out
    assert run("solve", cart, "--limit", "1e-9") == 3  # less than one iteration takes
    assert "NOT SOLVED (iteration limit)" in capsys.readouterr().out


def test_exit_code_of_an_interrupted_solve(
    cart: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The solver hands back the iterate; anywhere else Ctrl-C is a KeyboardInterrupt."""
    from testing.internals import NlpSolver

    original = NlpSolver.solve

    def interrupted(self: NlpSolver, *arguments: Any, **more: Any) -> Any:
        return original(self, *arguments, **more | {"callback": lambda info: info.iteration >= 2})

    monkeypatch.setattr(NlpSolver, "solve", interrupted)
    assert run("solve", cart) == 130
    assert "NOT SOLVED (interrupted)" in capsys.readouterr().out

    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(NlpSolver, "solve", stop)
    assert run("solve", cart) == 130
    assert complaint(capsys) == "gnc-opt: interrupted\n"


def test_check_describes_the_problem(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("check", cart) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("cart: no error in the statement\n")
    assert "phase leg: 2 states (q, v), 1 control (a), 0 path constraints" in out
    assert "options of build(): far=1.0, limits=(-1.0, 1.0), name='cart', wrong=None" in out


def test_check_reports_a_wrong_problem(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("check", cart, "--set", "wrong=value") == 2
    assert "initial value of 'q'" in complaint(capsys)


def test_warnings_are_one_line(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cart.write_text(CART.replace("    model.ode(", "    model.parameter('spare', 1.0)\n    model.ode("))
    assert run("check", cart) == 0
    err = capsys.readouterr().err
    assert err.startswith("gnc-opt: warning: ") and "'spare'" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "farr=2"], "build() has no option 'farr': did you mean 'far'?"),
        (["--set", "far"], "--set 'far' is not understood: write NAME=VALUE"),
        (["--set", "limits=[1, 2"], "the value is not valid JSON"),
        (["--set", "wrong=name"], "cart.py, line 19: "),
        (["--set", "wrong=zero"], "cart.py, line 21: ZeroDivisionError: float division by zero"),
        (["--set", "wrong=nothing"], "build() returned NoneType, not a Problem"),
        (["--mesh", "20"], "mesh '20' is not understood: write SEGMENTSxDEGREE"),
        (["--scheme", "euler"], "invalid choice: 'EULER'"),
        (["--tol", "some"], "invalid parse_optional_number value: 'some'"),
        (["--solver-tol", "-1"], "tolerance is -1.0"),
        (["--json", "nowhere/out.json"], "--json nowhere/out.json: name a file in a folder that exists"),
        (["--frobnicate"], "unrecognized arguments: --frobnicate"),
    ],
)
def test_bad_input_is_one_sentence(
    cart: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert run("solve", cart, "--quiet", *options) == 2
    assert words in complaint(capsys)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.py", None, "absent.py' does not exist: name a Python file"),
        ("notes.txt", "build = 1", "notes.txt' is not a Python file"),
        ("empty.py", "", "has no function build()"),
        (
            "near.py",
            "def buld(): ...",
            "has no function build() that returns the Problem: did you mean 'buld'?",
        ),
        ("syntax.py", "x = 1\ndef build(:\n", "syntax.py, line 2: SyntaxError: "),
        ("broken.py", "\nimport nothing_of_this_name", "broken.py, line 2: ModuleNotFoundError"),
        (
            "branch.py",
            "import gnc_opt as go\nx = go.Model('m').state('x')\nu = 1 if x + 1 > 0 else 2",
            "branch.py, line 3: RuntimeError: ",
        ),
        ("leaving.py", "raise SystemExit(7)", "the file ends the program (exit code 7)"),
        ("needs.py", "def build(case): ...", "build() needs the option 'case': add --set case=..."),
    ],
)
def test_bad_files_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: str | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    assert run("check", tmp_path / name) == 2
    assert words in complaint(capsys)


@pytest.mark.parametrize(
    ("line", "remedy"),
    [
        ("u = max(x, x + 1)", "write casadi.if_else(condition, this, that), casadi.fmax(a, b)"),
        ("u = ca.vertcat(x, 1) @ ca.vertcat(x, 2)", "write a.T @ b, or casadi.dot(a, b)"),
        ("u = ca.norm_2([x, x])", "Build vectors with casadi.vertcat(a, b) first"),
    ],
)
def test_what_casadi_refuses_gets_a_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, remedy: str
) -> None:
    head = "import casadi as ca\nimport gnc_opt as go\nx = go.Model('m').state('x')\n"
    (tmp_path / "refused.py").write_text(head + line)
    assert run("check", tmp_path / "refused.py") == 2
    assert remedy in complaint(capsys)


def test_report_into_a_file_is_refused_before_solving(
    cart: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        sys.modules["gnc_opt.planning.optimal_control_solver"],
        "solve",
        lambda *_, **__: pytest.fail("it solved"),
    )
    assert run("solve", cart, "--report", cart) == 2
    assert "this is a file; name a folder" in complaint(capsys)


def test_debug_shows_the_traceback(cart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("check", cart, "--set", "wrong=zero", "--debug") == 2
    err = capsys.readouterr().err
    assert "Traceback" in err and "far / 0" in err and "gnc-opt: " in err


def test_no_command_at_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 2
    assert "COMMAND" in complaint(capsys)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2),
        ("-3", -3),
        ("2.5", 2.5),
        ("1e-3", 1e-3),
        ("inf", float("inf")),
        ("true", True),
        ("False", False),
        ("none", None),
        ("null", None),
        ("exact", "exact"),
        ("a=b", "a=b"),
        ("", ""),
        ('"2"', "2"),
        ("[1, 2.5, [true, null]]", [1, 2.5, [True, None]]),
        ('{"a": 1}', {"a": 1}),
    ],
)
def test_values_of_set(text: str, value: Any) -> None:
    name, read = parse_build_option(f"option={text}")
    assert name == "option"
    assert read == value and type(read) is type(value)


@pytest.mark.parametrize("text", ["=2", "two words=3", "2x=1", "name"])
def test_names_of_set_must_be_names(text: str) -> None:
    with pytest.raises(ProblemFileError, match="write NAME=VALUE"):
        parse_build_option(text)


def test_build_with_free_keywords_takes_any_name(tmp_path: Path) -> None:
    (tmp_path / "free.py").write_text("def build(case=1, **more): raise ValueError(sorted(more))")
    with pytest.raises(GncOptError, match=r"line 1: ValueError: \['anything'\]"):
        load_problem_file(tmp_path / "free.py").build({"anything": 1})


def test_siblings_can_be_imported(tmp_path: Path) -> None:
    folder = tmp_path / "zoo_of_problems"
    folder.mkdir()
    (folder / "zoo_helper.py").write_text("NUMBER = 7")
    (folder / "animal.py").write_text(
        "import zoo_helper\nfrom zoo_of_problems import zoo_helper as again\n"
        "def build(): raise ValueError(zoo_helper.NUMBER + again.NUMBER)"
    )
    with pytest.raises(ProblemFileError, match="ValueError: 14"):
        load_problem_file(folder / "animal.py").build({})


MODEL = """
import gnc_opt as go

def build(far=1.0):
    cart = go.Model("cart")
    x, u = cart.state("x"), cart.control("u")
    cart.ode({x: u})
    problem = go.Problem("package")
    leg = problem.phase("leg", cart)
    leg.time(initial=0.0, final=(0.1, 10.0))
    leg.initial(x=1.0 / far)
    leg.final(x=0.0)
    leg.bounds(u=(-1.0, 1.0))
    problem.minimize(leg.final_time)
    return problem
"""


@pytest.fixture
def package(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    """A problem of several files in a package of problems; its names are the test's own, and forgotten after it."""
    outer = f"herd_of_{request.node.originalname}"
    folder = tmp_path / outer / "cow"
    folder.mkdir(parents=True)
    (tmp_path / outer / "__init__.py").write_text("")
    (tmp_path / outer / "shared.py").write_text("MESH = '4x3'")
    (folder / "__init__.py").write_text(
        f"from {outer}.cow.model import build\nfrom {outer}.shared import MESH\n"
    )
    (folder / "model.py").write_text(MODEL)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == outer]:
        del sys.modules[name]


@pytest.mark.parametrize("named", ["cow", "cow/", "cow.py", "cow/__init__.py", "cow/model.py"])
def test_a_package_is_a_problem_whatever_the_current_folder_is(
    package: Path, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(package)
    file = load_problem_file(f"{package.parent}/{named}")
    assert file.build({"far": 2.0}).name == "package"
    if not named.endswith("model.py"):
        assert file.default_mesh == "4x3"
        assert file.module is sys.modules[f"{package.parent.name}.cow"]


def test_program_solves_a_package_from_another_folder(package: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / package.parent.name).mkdir(parents=True)
    (elsewhere / package.parent.name / "__init__.py").write_text("raise ImportError('another package')")
    done = subprocess.run(
        [sys.executable, "-m", "gnc_opt.cli", "solve", package.parent / "cow", "--set", "far=2"],
        capture_output=True,
        text=True,
        check=False,
        cwd=elsewhere,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"objective 0\.5000000\d* ", done.stdout)


def test_an_existing_file_goes_before_a_package_of_its_name(package: Path) -> None:
    (package.parent / "cow.py").write_text("MESH = '7x7'\ndef build(): ...")
    assert load_problem_file(package.parent / "cow.py").default_mesh == "7x7"
    assert load_problem_file(package.parent / "cow").default_mesh == "4x3"


def test_errors_in_a_package_name_its_file_and_line(
    package: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", package, "--set", "far=0") == 2
    assert f"{package}/model.py, line 11: ZeroDivisionError" in complaint(capsys)


def test_installed_program_knows_its_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gnc_opt.cli", "--version"], capture_output=True, text=True, check=True
    )
    assert re.fullmatch(r"gnc-opt \d+\.\d+\.\d+\S*\n", done.stdout)


def test_who_reads_no_further_ends_it_quietly() -> None:
    """As a shell does with other programs: `gnc-opt examples | head -1`."""
    code = "import sys; from gnc_opt.cli import main; sys.exit(main(['examples']))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as program:
        program.stdout.close()
        assert program.stderr.read() == b""
    assert program.returncode == 141
