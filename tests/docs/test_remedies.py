"""What to do when it does not solve: a page for every ending and every condition, for nothing else, and it shows it.

That the examples end so is tested with those of all pages (`test_examples`).
"""

from __future__ import annotations

import re

import pytest
from pages import DOCS, ROOT, Page, doc

import gnc_opt as go

INDEX = doc("when_it_does_not_solve")
CONDITIONS = re.findall(r"(?m)^### (.+)$", doc("verdict").text)
"""Compared with the code elsewhere."""
ENDINGS = {
    "status": ("How a solve ends", [status.value for status in go.Status]),
    "refinement": ("How a refinement ends", [status.value for status in go.RefinementStatus]),
    "conditions": ("Conditions of the verdict", CONDITIONS),
    "continuation": ("How a continuation ends", [status.value for status in go.ContinuationStatus]),
    "runs": ("What becomes of a run", [status.value for status in go.RunStatus]),
}
"""By the folder of their pages: section of the index and names."""


def pages_of(folder: str) -> dict[str, Page]:
    """Pages of a folder by their title."""
    there = [page for page in DOCS if page.path.parent == ROOT / "docs" / "howto" / folder]
    return {page.text.partition("\n")[0].removeprefix("# "): page for page in there}


@pytest.mark.parametrize("folder", ENDINGS)
def test_every_ending_has_its_page(folder: str) -> None:
    _, names = ENDINGS[folder]
    assert set(pages_of(folder)) == set(names)


@pytest.mark.parametrize("folder", ENDINGS)
def test_the_index_leads_to_every_page(folder: str) -> None:
    """The conditions in the order of the verdict: the page tells to begin with the first that fails."""
    heading, names = ENDINGS[folder]
    listed = re.findall(rf"(?m)^\| \[(.+?)\]\({folder}/(\w+)\.md\) \| \S", INDEX.section(heading))
    assert [name for name, _ in listed] == list(names)
    assert [stem for _, stem in listed] == [pages_of(folder)[name].path.stem for name in names]


@pytest.mark.parametrize("folder", ENDINGS)
def test_every_page_shows_its_ending_and_says_what_to_do(folder: str) -> None:
    for name, page in pages_of(folder).items():
        (example,) = page.code("python")
        never_fail = ("tables", "smoothness", "singular arcs", "strict switches")
        word = "CANNOT TELL" if name in never_fail else "FAIL"
        wanted = f"{word} {name}" if folder == "conditions" else name
        assert re.search(rf"(?m)^{wanted}\b", example.prints or ""), f"{page.name} does not show '{wanted}'"
        assert "**What to do.**" in page.text
