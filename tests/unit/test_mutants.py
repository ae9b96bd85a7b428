"""The mutation tester changes meaning, one place at a time, and nothing that is only shown."""

import ast
from pathlib import Path

import pytest

from benchmarks.mutants import trial
from benchmarks.mutants.cover import Cover, record
from benchmarks.mutants.mutations import keys, mutants_of
from benchmarks.mutants.trial import PARTS, Outcome, Trials, copy_tree


def changes(tmp_path: Path, source: str) -> set[str]:
    (tmp_path / "module.py").write_text(source, encoding="utf-8")
    found = mutants_of(tmp_path, "module.py")
    for mutant in found:
        ast.parse(mutant.applied(source.encode()))  # each of them is Python
    return {f"{m.before} -> {m.after}" for m in found}


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("return a < b", {"a < b -> (a >= b)"}),
        ("return len(a) > b", {"len(a) > b -> (len(a) <= b)", "len(a) > b -> (len(a) >= b)"}),
        ("return a + b / c", {"a + b / c -> (a - b / c)", "b / c -> (b * c)"}),
        ("return -a if b else not c", {"-a -> a", "b -> (not b)", "not c -> c"}),
        ("return a and max(b, c)", {"a and max(b, c) -> (a or max(b, c))", "max -> min"}),
        ("return np.abs(a)", {"np.abs(a) -> a"}),
        ("return np.sum(a, axis=b)", {"np.sum(a, axis=b) -> np.sum(a)"}),
        ("return a(t, 'left')", {"'left' -> 'right'"}),
        ("return a[b:c]", {"b:c -> :c", "b:c -> b:"}),
        ("return a(True, 3, 0.5, 1e-9)", {"True -> False", "3 -> 4", "0.5 -> 1.0"}),
        ("a[b] = c\n    a += c\n    return a", {"a[b] = c -> pass", "a += c -> pass"}),
        ("for b in a:\n        b()\n    return a", {"b() -> pass"}),
        ("if a:\n        return b\n    return c", {"a -> (not a)", "return b -> pass"}),
        ("return [b for b in a if c]", {"c -> True"}),
        ("λ = 2\n    return λ - a", {"2 -> 3", "λ - a -> (λ + a)"}),
    ],
)
def test_what_is_changed(tmp_path: Path, body: str, expected: set[str]) -> None:
    assert changes(tmp_path, f"def f(a, b, c):\n    {body}\n") == expected


@pytest.mark.parametrize(
    "source",
    [
        "LEAST = 1e-6\nMOST = 3 * 4\n",
        'def f(a):\n    """Add 1 + 1."""\n    raise ValueError(f"{a + 1} is > 0")\n',
        "def f(a):\n    assert a > 0 and a < 1\n",
        "class A:\n    size: int\n\n    def __str__(self):\n        return 'a' + str(self.size + 1)\n",
        "def f(a):\n    return [*zip(a, a, strict=True)]\n",
        "class A:\n    size: int = field(repr=False)\n",
    ],
)
def test_what_is_left_alone(tmp_path: Path, source: str) -> None:
    assert changes(tmp_path, source) == set()


def test_keys_tell_equal_pieces_apart_and_survive_other_edits(tmp_path: Path) -> None:
    def named(source: str) -> list[str]:
        (tmp_path / "module.py").write_text(source)
        return [key for key, _ in keys(mutants_of(tmp_path, "module.py"))]

    function = "def f(a):\n    return g(-a, -a)\n"
    before = named(function)
    assert before == ["module.py f: -a -> a", "module.py f: -a -> a #2"]
    assert named("def e(a):\n    return a\n\n\n" + function) == before


CODE = """def double(a):
    return 2 * a


def often(a):
    return 5 * a
"""
TESTS = """import pathlib
from gnc_opt.module import double, often


def test_double():
    assert double(4) == 8


def test_often():
    often(1)


def test_place():
    assert often(1) == 5 and (pathlib.Path(__file__).parents[1] / "here").exists()


def test_broken():
    assert double(1) == 3
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package of two functions: one is tested, one only by a test that fails elsewhere than at home."""
    root = tmp_path_factory.mktemp("tree")
    for part in PARTS:
        (root / part).write_text("") if "." in part else (root / part).mkdir()
    (root / "pyproject.toml").write_text('[tool.pytest.ini_options]\npythonpath = ["."]\n')
    for name, text in (
        ("gnc_opt/__init__.py", ""),
        ("gnc_opt/module.py", CODE),
        ("tests/test_module.py", TESTS),
    ):
        (root / name).write_text(text)
    (root / "here").write_text("")
    record(root, root / "map", ["tests"])
    return root


def test_what_tests_notice_and_what_they_do_not(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lines above have moved since the map was recorded; a test that fails without any change kills nothing."""
    file = "gnc_opt/module.py"
    (tree / file).write_text("LONG = 1\nNEW = 2\n\n\n" + CODE)
    cover = Cover.read(tree, tree / "map", {file})
    copy_tree(tree, tmp_path)
    monkeypatch.setattr(trial, "FOREIGN", ("pytest",))
    trials = Trials(tmp_path)
    cover = cover.only(trials.collected(cover.modules))
    assert {t.split("::")[1] for t in cover.seconds} == {"test_double", "test_often", "test_place"}
    assert cover.lines[file][6] == {"tests/test_module.py::test_double"}
    mutants = {(m.where, m.after): m for m in mutants_of(tree, file)}
    killed, survived = (
        trials.attempt(mutants[key], cover, 60.0) for key in (("double", "3"), ("often", "6"))
    )
    assert (killed.result, killed.by) == ("killed", "tests/test_module.py::test_double")
    assert (
        survived.result == "survived" and survived.tests == 2
    )  # its own test that stands, and the one beside it
    assert (tmp_path / file).read_text() == (tree / file).read_text()
    nothing = Cover({file: {}}, {})
    assert trials.attempt(mutants["double", "3"], nothing, 60.0) == Outcome("uncovered")
