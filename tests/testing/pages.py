"""The pages of the documentation, taken apart: blocks of code with what they print, inline code, commands, links."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).parents[2]

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)

COMMAND = re.compile(r"(?:gnc-opt|python3? -m (?:problems|benchmarks)\.)[ \w][^`\n#]*")


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes
    ----------
    language, code : str
    line : int
        Of the page, at which the code begins.
    prints : str or None
        The text block that follows after the word "prints".
    """

    language: str
    code: str
    line: int
    prints: str | None = None


@dataclass(frozen=True)
class Page:
    """A Markdown file of the repository."""

    path: Path

    @property
    def name(self) -> str:
        return str(self.path.relative_to(ROOT))

    @cached_property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @cached_property
    def blocks(self) -> list[Block]:
        """All fenced blocks in their order."""
        fences = list(FENCE.finditer(self.text))
        return [
            Block(
                fence[1],
                fence[2],
                self.text.count("\n", 0, fence.start(2)) + 1,
                follower[2] if follower and self._is_output(fence, follower) else None,
            )
            for fence, follower in zip(fences, [*fences, None][1:], strict=True)
        ]

    def _is_output(self, fence: re.Match[str], follower: re.Match[str]) -> bool:
        between = self.text[fence.end() : follower.start()]
        return follower[1] == "text" and between.split() == ["prints"]

    def code(self, language: str) -> list[Block]:
        """The blocks of a language."""
        return [block for block in self.blocks if block.language == language]

    @cached_property
    def prose(self) -> str:
        """The page without its fenced and indented blocks, and without the names of other tools in the first column."""
        text = re.sub(r"(?m)^ {4}(?! *[*-] ).*$", "", FENCE.sub("", self.text))
        return re.sub(r"(?m)^\|[^|]*\|", "|", text) if self.path.parent.name == "coming_from" else text

    @cached_property
    def spans(self) -> list[str]:
        """Inline code, each once."""
        return list(dict.fromkeys(" ".join(span.split()) for span in re.findall(r"`([^`]+)`", self.prose)))

    @cached_property
    def commands(self) -> list[str]:
        """Command lines, wherever they stand; a usage that runs over several lines is one."""
        joined = re.sub(r"\n +(?=\[--)", " ", self.text)
        return [found.strip() for found in COMMAND.findall(joined)]

    @cached_property
    def links(self) -> list[str]:
        """Targets of links to files, without their anchors."""
        return [target for target in re.findall(r"\]\(([^)#:\s]+)[^):]*\)", self.text) if target]

    def section(self, heading: str) -> str:
        """The text of a section, up to the next heading of its level or above."""
        found = re.search(rf"(?m)^(#+) {re.escape(heading)}$", self.text)
        assert found, f"{self.name} has no section '{heading}'"
        rest = self.text[found.end() :]
        end = re.search(rf"(?m)^#{{1,{len(found[1])}}} ", rest)
        return rest[: end.start()] if end else rest


def documented(section: str) -> list[str]:
    """Return the keys in the first column of a table; later ones in a row share the parent of the first."""
    found: list[str] = []
    for row in re.findall(r"(?m)^\| (`.*?) \|", section):
        first, *others = re.findall(r"`([^`]+)`", row)
        parent = first.rpartition(".")[0]
        found += [first, *(f"{parent}.{name}".lstrip(".") for name in others)]
    return found


def options(text: str) -> set[str]:
    """Return the long options of a command line or a help text."""
    return set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", text))


def subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of the subcommands by name."""
    return next(a.choices for a in parser._actions if isinstance(a, argparse._SubParsersAction))


README = Page(ROOT / "README.md")
CONTRIBUTING = Page(ROOT / "CONTRIBUTING.md")
DOCS = [Page(path) for path in sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [README, CONTRIBUTING, *DOCS]


def doc(name: str, folder: str | None = None) -> Page:
    """The page of this name in ``docs/`` or a folder there."""
    found = (page for page in DOCS if page.path.stem == name)
    return next(page for page in found if folder is None or page.path.parent.name == folder)
