"""Docstrings write mathematics as Sphinx does; a page of Markdown writes it between dollars."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import dedent
from typing import Any

import griffe

DOCS = Path(__file__).parents[1] / "docs"

_BLOCK = re.compile(r"^([ \t]*)\.\. math::(.*(?:\n(?:\1[ \t]+\S.*|[ \t]*(?=\n\1[ \t]+\S)))*)", re.MULTILINE)
_INLINE = re.compile(r":math:`([^`]+)`")
_PAGE = re.compile(r"``docs/([\w/]+\.md)``")
_UNDERLINED = re.compile(r"^([A-Z]\w*(?: \w+)?)\n-{3,}$", re.MULTILINE)
_PARAMETERS = re.compile(r"^Parameters\n-+\n.*?(?=^\w[\w ]*\n-{3,}\n|\Z)", re.DOTALL | re.MULTILINE)
_SEVERAL = re.compile(r"^(\w+(?:, \w+)+)\n((?:    .*(?:\n|\Z)|\n(?=    ))+)", re.MULTILINE)


def dollars(text: str) -> str:
    """Return a text with its ``math`` directives and roles between dollars."""

    def block(found: re.Match[str]) -> str:
        indent, formula = found[1], dedent(found[2]).strip()
        formula = "\n".join(f"{indent}{line.strip()}" for line in formula.splitlines() if line.strip())
        if "&" in formula and r"\begin" not in formula:
            formula = f"{indent}\\begin{{split}}\n{formula}\n{indent}\\end{{split}}"
        return f"\n{indent}$$\n{formula}\n{indent}$$\n"

    inline = _INLINE.sub(lambda found: f"${' '.join(found[1].split())}$", text)
    return _BLOCK.sub(block, inline)


def module_page(docstring: str) -> str:
    """Return the docstring of a module as Markdown, with links to pages; its headings are no headings of the page."""

    def link(found: re.Match[str]) -> str:
        title = (DOCS / found[1]).read_text(encoding="utf-8").partition("\n")[0]
        return f"[{title.removeprefix('# ').partition(':')[0]}](../{found[1]})"

    return _PAGE.sub(link, _UNDERLINED.sub(r"**\1**\n", dollars(docstring)))


def separate_parameters(docstring: str) -> str:
    """Return a docstring in which parameters described together stand alone; else all have the type of the first."""

    def each(found: re.Match[str]) -> str:
        return "".join(f"{name}\n{found[2].rstrip()}\n" for name in found[1].split(", "))

    return _PARAMETERS.sub(lambda section: _SEVERAL.sub(each, section[0]), docstring)


class SphinxMath(griffe.Extension):
    """For mkdocstrings: the docstring of every object, read by `dollars`, and of an enumeration its values."""

    def on_class_members(self, *, cls: griffe.Class, **more: Any) -> None:
        if cls.docstring and any(str(base).endswith(("Enum", "StatusWord")) for base in cls.bases):
            values = [
                f"`{name}`" for name, member in cls.members.items() if member.is_attribute and name.isupper()
            ]
            if values and "Attributes\n" not in cls.docstring.value:
                cls.docstring.value += f"\n\nValues: {', '.join(values)}."

    def on_object(self, *, obj: griffe.Object, **more: Any) -> None:
        if obj.docstring:
            obj.docstring.value = separate_parameters(dollars(obj.docstring.value))
