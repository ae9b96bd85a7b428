"""Statements and constants of source files, without the many expressions that a walk through the whole tree visits."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

from testing.pages import ROOT


def source_files(*folders: str) -> list[Path]:
    """Return the Python files of folders of the repository."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def walk_statements(path: Path) -> Iterator[ast.AST]:
    """Yield all statements of a file, those inside others too."""
    waiting: list[Any] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        yield node
        for block in ("body", "orelse", "finalbody", "handlers", "cases"):
            waiting += getattr(node, block, ())


def string_constants(path: Path) -> Iterator[str]:
    """Yield the texts of a file, with docstrings and the constant parts of f-strings, from its compiled code."""
    waiting = [SourceFileLoader(path.stem, str(path)).get_code(path.stem)]
    while waiting:
        code = waiting.pop()
        assert code is not None
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                waiting.append(constant)
            else:
                yield from _texts_in(constant)


def _texts_in(constant: object) -> Iterator[str]:
    if isinstance(constant, str):
        yield constant
    elif isinstance(constant, (tuple, frozenset)):
        for entry in constant:
            yield from _texts_in(entry)
