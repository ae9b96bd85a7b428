"""What the pages show is what happens: every block of Python runs, and prints what the page says it prints."""

from __future__ import annotations

import contextlib
import io
import re
from typing import Any

import pytest
from testing.pages import DOCS, PAGES, README, Block, Page

NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\d.])")

EFFORT = re.compile(r"\d+(?= iterations)|(?<=transcription )\S+|(?<=solve )\S+|(?<=time spent   )\S+")
"""What a solve costs depends on the machine and on versions."""

ROUNDING = 1e-7
"""A line with a smaller number than this tells of rounding; its numbers differ from machine to machine."""


def run(block: Block, page: Page, names: dict[str, Any]) -> list[str]:
    """Execute a block in the names of its page; return the lines that it prints."""
    stream = io.StringIO()
    code = compile("\n" * (block.line - 1) + block.code, page.name, "exec")  # tracebacks name the page's line
    with contextlib.redirect_stdout(stream):
        exec(code, names)
    return stream.getvalue().splitlines()


def masked(line: str) -> str:
    """Return the words of a line: numbers and the blanks that align them taken out."""
    return " ".join(NUMBER.sub("#", line).split())


def numbers(line: str) -> list[str]:
    """Return the numbers of a line that do not depend on the machine."""
    found = NUMBER.findall(EFFORT.sub("", line))
    return [] if any(0 < abs(float(n)) < ROUNDING for n in found) else found


def agree(printed: str, shown: str) -> bool:
    """Whether two numbers agree: whole ones exactly, others to two units of their third digit or better.

    A number shown with n digits may be off by two in its last one, or by 1e-7 if it has more than eight.
    """
    if printed == shown:
        return True
    digits = len(re.sub(r"e.*|[-+.]", "", shown).lstrip("0"))
    if not re.search(r"[.e]", shown + printed):
        return False
    return abs(float(printed) - float(shown)) <= max(2 * 10.0 ** (1 - digits), 1e-7) * abs(float(shown))


def differences(printed: list[str], shown: list[str]) -> list[str]:
    """Return the pairs of lines that do not say the same."""
    if len(printed) != len(shown):
        return [f"{len(printed)} lines printed, {len(shown)} shown:", *printed]
    return [
        f"printed: {line}\n  shown: {other}"
        for line, other in zip(printed, shown, strict=True)
        if masked(line) != masked(other) or not all(map(agree, numbers(line), numbers(other)))
    ]


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("page", [page for page in PAGES if page.code("python")], ids=lambda page: page.name)
def test_examples_run_and_print_what_the_page_says(
    page: Page, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the order of the page, with the names of the earlier blocks, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": page.name}
    for block in page.code("python"):
        printed = run(block, page, names)
        if block.prints is None:
            assert not printed, f"{page.name}, line {block.line}: it prints, and the page does not say what"
        else:
            wrong = differences(printed, block.prints.splitlines())
            assert not wrong, f"{page.name}, line {block.line}:\n" + "\n".join(wrong)


def test_the_first_example_is_short() -> None:
    code = README.code("python")[0].code
    assert len([line for line in code.splitlines() if line.strip()]) <= 22


@pytest.mark.parametrize(
    "page",
    [
        p
        for p in DOCS
        if p.path.stem not in ("index", "glossary", "renamed") and p.path.parent.name != "systems"
    ],
    ids=lambda page: page.name,
)
def test_every_page_shows_what_it_says(page: Page) -> None:
    assert page.code("python"), f"{page.name} has no example"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_blocks_say_what_they_are(page: Page) -> None:
    """A block without a language would escape its test."""
    assert page.text.count("```") == 2 * len(page.blocks)
    languages = {block.language for block in page.blocks}
    assert languages <= {"python", "text", "sh", "c"}, languages


@pytest.mark.parametrize(
    ("printed", "shown"),
    [
        ("objective 2.0000006", "objective 2.000000037"), ("0.957", "0.9550"), ("500 ok", "499 ok"),
        ("error in q", "error in v"), ("1e-3 m", "1.3e-3 m"), ("-1.0", "1.0"),
    ],
)  # fmt: skip
def test_other_numbers_and_words_are_found(printed: str, shown: str) -> None:
    assert differences([printed], [shown])
    assert differences([printed, ""], [printed])


@pytest.mark.parametrize(
    ("printed", "shown"),
    [
        (
            "mesh 20x4 LG, 17 iterations, transcription 0.1 s, solve 0.2 s",
            "mesh 20x4 LG, 16 iterations, transcription 3 s, solve 1 s",
        ),
        ("objective 2.00000004", "objective 2.000000037"),
        ("defect 2.1e-10, segment 3", "defect 1.7e-10, segment 4"),
        ("q   0.000163 m", "q  0.000164 m"),
    ],
)
def test_effort_rounding_and_last_digits_may_differ(printed: str, shown: str) -> None:
    assert not differences([printed], [shown])
