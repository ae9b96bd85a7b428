"""Mutations: small changes of meaning, one place at a time.

Comparisons are turned round (and, against integers, moved by one), arithmetic swapped, signs and conditions negated,
``and``/``or``, ``min``/``max``, ``any``/``all`` and "left"/"right" swapped, absolute values and options of array
functions dropped, integers raised by one, factors doubled, slices opened, stores, calls and early returns left out.

Left alone: what is only shown (messages, ``__str__``), annotations, decorators, assertions, and numeric tuning: module
constants, and floats below `TUNING` or above its inverse, which are tolerances and penalties.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

TUNING = 1e-2
"""Smaller numbers are tolerances: another one is no other meaning."""

_TURNED = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_NEXT = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
_ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
_CALLS = {
    "min": "max",
    "any": "all",
    "minimum": "maximum",
    "fmin": "fmax",
    "argmin": "argmax",
    "floor": "ceil",
}
_CALLS |= {new: old for old, new in _CALLS.items()}
_IDENTITIES = {"abs", "fabs", "absolute", "flip", "cumsum", "sorted", "sort", "unique", "conj"}
_ARRAY_MODULES = {"np", "ca", "scipy", "linalg"}
_SHOWN = {"__str__", "__repr__", "_repr_html_"}


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes
    ----------
    file : str
        Path from the root of the tree.
    line : int
    where : str
        Dotted name of the function or class.
    before, after : str
        The piece of the source that changes.
    first, last : int
        Its place in the file, in bytes.
    lines : tuple of int
        First and last line of the piece, for the tests that come by.
    """

    file: str
    line: int
    where: str
    before: str
    after: str
    first: int
    last: int
    lines: tuple[int, int]

    @property
    def key(self) -> str:
        """A name that survives edits elsewhere in the file."""
        return f"{self.file} {self.where}: {_flat(self.before)} -> {_flat(self.after)}"

    def applied(self, source: bytes) -> bytes:
        """Return the source with the change."""
        return source[: self.first] + self.after.encode() + source[self.last :]

    def diff(self, source: bytes) -> str:
        """Return the lines before and after, as in a diff."""
        start, stop = source.rfind(b"\n", 0, self.first) + 1, source.find(b"\n", self.last)
        changed = source[start : self.first] + self.after.encode() + source[self.last : stop]
        return f"- {_flat(source[start:stop].decode())}\n+ {_flat(changed.decode())}"


def mutants_of(root: Path, package: str) -> list[Mutant]:
    """Return all mutants of the Python files at a path below the root (a folder or one file), in order."""
    place = root / package
    files = [place] if place.is_file() else sorted(place.rglob("*.py"))
    return [m for file in files for m in _Finder(str(file.relative_to(root)), file.read_bytes()).find()]


class _Finder(ast.NodeVisitor):
    """Walks through a module and notes what can be changed."""

    def __init__(self, file: str, source: bytes) -> None:
        self._file, self._source = file, source
        lengths = [len(line) for line in source.splitlines(keepends=True)]
        self._starts = [sum(lengths[:i]) for i in range(len(lengths) + 1)]
        self._where: list[str] = []
        self._found: dict[tuple[int, int, str], Mutant] = {}

    def find(self) -> list[Mutant]:
        self.visit(ast.parse(self._source))
        return sorted(self._found.values(), key=lambda m: (m.first, m.last, m.after))

    # --- where to look ------------------------------------------------------------------------------------

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name in _SHOWN:
            return
        self._where.append(node.name)
        for default in [*node.args.defaults, *filter(None, node.args.kw_defaults)]:
            self.visit(default)
        self._body(node.body)
        self._where.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._where.append(node.name)
        self._body(node.body)
        self._where.pop()

    def visit_Module(self, node: ast.Module) -> None:
        self._body([s for s in node.body if not isinstance(s, (ast.Assign, ast.AnnAssign, ast.If))])

    def _body(self, statements: list[ast.stmt]) -> None:
        for k, statement in enumerate(statements):
            self._drop(statement, last=k == len(statements) - 1 and len(self._where) > 0)
            self.visit(statement)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Messages are for people."""

    visit_JoinedStr = visit_Assert = visit_Import = visit_ImportFrom = visit_Raise  # type: ignore[assignment]

    # --- what to change -----------------------------------------------------------------------------------

    def visit_If(self, node: ast.If) -> None:
        self._negate(node.test)
        self.visit(node.test)
        for branch in (node.body, node.orelse):
            for statement in branch:
                self._drop(statement, last=False)
                self.visit(statement)

    def visit_For(self, node: ast.For) -> None:
        self.visit(node.iter)
        self._loop(node.body)

    def visit_While(self, node: ast.While) -> None:
        self.visit(node.test)
        self._loop(node.body)

    def _loop(self, statements: list[ast.stmt]) -> None:
        for statement in statements:
            self._drop(statement, last=False)
            self.visit(statement)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._note(test, ast.Constant(True))
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for i, operator in enumerate(node.ops):
            self._change(node, lambda n, i=i, o=operator: n.ops.__setitem__(i, _TURNED[type(o)]()))
            if type(operator) in _NEXT and any(_whole(n) for n in (node.left, *node.comparators)):
                self._change(node, lambda n, i=i, o=operator: n.ops.__setitem__(i, _NEXT[type(o)]()))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self._change(node, lambda n: setattr(n, "op", ast.And() if isinstance(n.op, ast.Or) else ast.Or()))
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        literals = (ast.List, ast.ListComp, ast.Tuple, ast.JoinedStr)
        text = any(_is_text(n) or isinstance(n, literals) for n in (node.left, node.right))
        if type(node.op) in _ARITHMETIC and not text:
            self._change(node, lambda n: setattr(n, "op", _ARITHMETIC[type(n.op)]()))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, (ast.Not, ast.Invert)) or not isinstance(node.operand, ast.Constant):
            self._note(node, node.operand)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in _CALLS:
            self._change(
                node.func, lambda n: setattr(n, "attr" if hasattr(n, "attr") else "id", _CALLS[name])
            )
        if name in _IDENTITIES and len(node.args) == 1 and not node.keywords:
            self._note(node, node.args[0])
        if _root(node.func) in _ARRAY_MODULES:
            for i in range(len(node.keywords)):
                self._change(node, lambda n, i=i: n.keywords.pop(i))
        for child in (node.func, *node.args, *node.keywords):
            # an assertion of zip, as those of `assert`; what of a dataclass is shown
            if getattr(child, "arg", "") not in ("strict", "repr"):
                self.visit(child)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._note(node, ast.Constant(not value))
        elif isinstance(value, int):
            self._note(node, ast.Constant(value + 1))
        elif isinstance(value, float) and (value == 0 or TUNING <= abs(value) <= 1 / TUNING):
            self._note(node, ast.Constant(2 * value if value else 1.0))
        elif value in ("left", "right"):
            self._note(node, ast.Constant("left" if value == "right" else "right"))

    def visit_Slice(self, node: ast.Slice) -> None:
        for side in ("lower", "upper"):
            if getattr(node, side) is not None:
                self._change(node, lambda n, side=side: setattr(n, side, None))
        self.generic_visit(node)

    def _drop(self, statement: ast.stmt, last: bool) -> None:
        """Leave a statement out, if what follows can do without."""
        stores = isinstance(statement, ast.Assign) and all(
            isinstance(t, ast.Subscript) for t in statement.targets
        )
        calls = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call)
        jumps = isinstance(statement, (ast.Return, ast.Continue, ast.Break)) and not last
        if stores or calls or jumps or isinstance(statement, ast.AugAssign):
            self._note(statement, ast.Pass())

    def _negate(self, test: ast.expr) -> None:
        if not isinstance(test, (ast.Compare, ast.UnaryOp)):  # these are turned round themselves
            self._note(test, ast.UnaryOp(ast.Not(), test))

    # --- notes ----------------------------------------------------------------------------------------------

    def _change(self, node: ast.expr, change: Callable[..., object]) -> None:
        new = copy.deepcopy(node)
        change(new)
        self._note(node, new)

    def _note(self, node: ast.expr | ast.stmt, new: ast.AST) -> None:
        assert node.end_lineno is not None and node.end_col_offset is not None
        first = self._starts[node.lineno - 1] + node.col_offset
        last = self._starts[node.end_lineno - 1] + node.end_col_offset
        text = ast.unparse(ast.fix_missing_locations(new))
        plain = isinstance(
            new, (ast.Constant, ast.Name, ast.Attribute, ast.Call, ast.Subscript, ast.Slice, ast.Pass)
        )
        after = text if plain else f"({text})"
        before = self._source[first:last].decode()
        where = ".".join(self._where) or "module"
        lines = (node.lineno, node.end_lineno)
        if text != before:
            self._found[first, last, after] = Mutant(
                self._file, node.lineno, where, before, after, first, last, lines
            )


def _flat(text: str) -> str:
    return " ".join(text.split())


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _whole(node: ast.expr) -> bool:
    """Whether an operand is plainly an integer, so that < and <= differ."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int)
    if isinstance(node, ast.Call):
        return getattr(node.func, "id", "") == "len"
    return isinstance(node, ast.Attribute) and node.attr == "size"


def _root(node: ast.expr) -> str:
    while isinstance(node, ast.Attribute):
        node = node.value
    return getattr(node, "id", "")


def keys(mutants: list[Mutant]) -> Iterator[tuple[str, Mutant]]:
    """Yield each mutant with its key, numbered where a function holds the same piece twice."""
    seen: dict[str, int] = {}
    for mutant in mutants:
        seen[mutant.key] = seen.get(mutant.key, 0) + 1
        yield mutant.key + (f" #{seen[mutant.key]}" if seen[mutant.key] > 1 else ""), mutant
