"""The problems that come with gnc_opt: found where they are installed, listed, and run as in the repository."""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path

from gnc_opt.errors import GncOptError, unknown_name

_HOLDERS = (Path(__file__).parent / "shipped", Path(__file__).parents[1])
"""Where the package ``problems`` may lie: inside an installed gnc_opt, or beside it in the repository."""


@dataclass(frozen=True)
class Example:
    """A problem file, or a system of several files in a folder."""

    path: Path

    @property
    def name(self) -> str:
        """By which it is run."""
        return self.path.stem

    @property
    def is_system(self) -> bool:
        """Whether it is a folder."""
        return self.path.is_dir()

    @cached_property
    def statement(self) -> str:
        """Its docstring: what is asked, what it teaches, and where the answer is known from."""
        source = self.path / "__init__.py" if self.is_system else self.path
        return ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""

    @property
    def title(self) -> str:
        """The first line of the statement."""
        return self.statement.partition("\n")[0].rstrip(".")

    def run(self, arguments: Sequence[str] = ()) -> int:
        """Solve, judge, compare with what is known and print; return the exit code.

        Parameters
        ----------
        arguments : sequence of str
            Options of the problem's own command line, such as ``--json OUT``.
        """
        holder = str(self.path.parents[1])
        if holder not in sys.path:
            sys.path.insert(0, holder)  # its modules import each other as those of the package `problems`
        return int(import_module(f"problems.{self.name}").main(arguments))


def examples() -> list[Example]:
    """Return every problem, files first, each by name.

    Raises
    ------
    GncOptError
        The problems are not where gnc_opt is.
    """
    for holder in _HOLDERS:
        folder = holder / "problems"
        if (folder / "reference.py").is_file():
            files = [path for path in sorted(folder.glob("*.py")) if "def build(" in path.read_text("utf-8")]
            return [
                Example(path) for path in (*files, *sorted(p.parent for p in folder.glob("*/__main__.py")))
            ]
    raise GncOptError("the problems that come with gnc_opt are not beside it: install gnc_opt again.")


def example(name: str) -> Example:
    """Return the problem of this name; raise `UnknownNameError` if there is none."""
    found = {each.name: each for each in examples()}
    if name not in found:
        raise unknown_name("example", name, "gnc_opt", found)
    return found[name]
