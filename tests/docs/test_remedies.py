"""The reference of statuses, outcomes and conditions has a section for each, with an example that ends so and a remedy.

That the examples end so is tested with those of all pages (`test_examples`).
"""

from __future__ import annotations

import re

import pytest
from testing.pages import FENCE, PAGES, ROOT, Page, doc
from testing.source_files import source_files, string_constants

import gnc_opt as go
from website import redirects

CONDITIONS = re.findall(r"(?m)^### (.+)$", doc("verdict").text)
"""Compared with the code elsewhere."""

REFERENCES = {
    "Solve": ("statuses", [status.value for status in go.Status]),
    "Refinement": ("statuses", [status.value for status in go.RefinementStatus]),
    "Continuation": ("statuses", [status.value for status in go.ContinuationStatus]),
    "outcomes": ("outcomes", [status.value for status in go.RunStatus]),
    "conditions": ("conditions", CONDITIONS),
}
"""Page and names, in their order, by the section of the page or the page."""

HEADING = re.compile(r"(?m)^(#+) (.+?)(?: \{ #([\w-]+) \})?$")


def sections(reference: str) -> dict[str, str]:
    """Return the text of each section of a reference by its name."""
    name, _ = REFERENCES[reference]
    page = doc(name)
    text = page.section(reference) if reference in ("Solve", "Refinement", "Continuation") else page.text
    level = "##" if name == "outcomes" else "###"
    found = re.split(rf"(?m)^{level} (.+?)(?: \{{ #[\w-]+ \}})?$", text)
    return dict(zip(found[1::2], found[2::2], strict=True))


@pytest.mark.parametrize("reference", REFERENCES)
def test_every_name_has_its_section(reference: str) -> None:
    assert list(sections(reference)) == REFERENCES[reference][1]


@pytest.mark.parametrize("reference", REFERENCES)
def test_every_section_shows_its_example_and_the_remedy(reference: str) -> None:
    for name, text in sections(reference).items():
        printed = "".join(fence[2] for fence in FENCE.finditer(text) if fence[1] == "text")
        wanted = f"FAIL {name}" if reference == "conditions" else name
        assert re.search(rf"(?m)^{wanted}\b", printed), f"{reference}: {name} is not shown"
        assert "**Remedy.**" in text, name


def anchors(page: Page) -> set[str]:
    """Return the anchors of a page's headings, as the site makes them."""
    found = HEADING.findall(FENCE.sub("", page.text))
    return {
        anchor or re.sub(r"[^\w\s-]", "", text).strip().lower().replace(" ", "-") for _, text, anchor in found
    }


def test_old_addresses_lead_to_sections() -> None:
    for new in redirects.targets().values():
        page, _, anchor = new.partition(".html")
        assert not anchor or anchor[1:] in anchors(doc(page.rpartition("/")[2])), new


def messages() -> str:
    """Return all texts of the package and of its templates, with docstrings."""
    return "\n".join(text for path in source_files("gnc_opt") for text in string_constants(path))


def test_pages_that_messages_name_exist() -> None:
    text = messages()
    titles = {page.text.partition("\n")[0].removeprefix("# ") for page in PAGES}
    named = re.findall(r"the page '([^']+)'", text)
    assert named and set(named) <= titles
    for name, anchor in re.findall(r"(?<![\w/])docs/([\w/]+)\.md(?:#([\w-]+))?", text):
        assert (ROOT / "docs" / f"{name}.md").is_file(), name
        assert not anchor or anchor in anchors(doc(name.rpartition("/")[2])), anchor


@pytest.mark.parametrize("kind", [go.Status, go.RefinementStatus, go.ContinuationStatus])
def test_every_status_that_a_message_names_has_an_anchor(kind: type) -> None:
    known = anchors(doc("statuses"))
    prefix = {go.Status: "", go.RefinementStatus: "refinement-", go.ContinuationStatus: "continuation-"}[kind]
    assert not [status.value for status in kind if f"{prefix}{status.value}" not in known]


def test_every_outcome_and_condition_that_a_message_names_has_an_anchor() -> None:
    wanted = [status.value.replace(" ", "-") for status in go.RunStatus]
    assert set(wanted) <= anchors(doc("outcomes"))
    assert {name.replace(" ", "-") for name in CONDITIONS} <= anchors(doc("conditions"))
