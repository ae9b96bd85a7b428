"""What the site adds to the pages: the reference of every public name, the gallery, links and formulas."""

from __future__ import annotations

import importlib
import inspect
import re
import types
from pathlib import Path
from typing import Any

import pytest
from testing.pages import PAGES, README, ROOT

from gnc_opt.problem_files_and_examples import list_examples

pytest.importorskip("mkdocs", reason="the site is built with the extra docs")
pytest.importorskip("latex2mathml")
pytest.importorskip("griffe")

from website import api, figures, gallery, hooks, sphinx_math


def test_every_public_name_is_in_the_reference_once() -> None:
    told = re.findall(r"(?m)^::: (\S+)$", "\n".join(api.pages().values()))
    assert len(told) == len(set(told))
    for package, names in api.package_names().items():
        for name in names:
            value = getattr(importlib.import_module(package), name)
            named = inspect.isclass(value) or inspect.isfunction(value)
            if named:
                assert f"{value.__module__}.{value.__qualname__}" in told
            else:
                assert any(path.endswith(f".{name}") for path in told), f"{package}.{name}"


def test_the_index_lists_every_name_of_gnc_opt() -> None:
    index = api.pages()["api/index.md"]
    assert not [name for name in api.gnc_opt.__all__ if f"`go.{name}`" not in index]


def test_the_header_shows_the_version_of_the_changelog() -> None:
    """Pages of an unreleased version are not those of the last release."""
    changelog = "# Log\n\n## Unreleased (0.4.0)\n\n## 0.3.0 (2026-11-22)\n"
    assert hooks.documented_version(changelog) == "0.4.0 (unreleased)"
    assert hooks.documented_version("# Log\n\n## 0.3.0 (2026-11-22)\n") == "0.3.0"


def test_a_picture_has_its_description_as_caption() -> None:
    page: Any = types.SimpleNamespace(file=types.SimpleNamespace(src_uri="howto/phases.md"))
    for name, kind in (("phases", "picture"), ("loop_bode", "picture wide")):
        shown = hooks.on_page_content(f'<p><img alt="Words." src="../{name}.svg" /></p>', page=page)
        assert f'<figure class="{kind}">' in shown and "<figcaption>Words.</figcaption>" in shown
    shown = hooks.on_page_content('<p><a href="x"><img alt="" src="../overview.png"></a></p>', page=page)
    assert '<figure class="picture wide"><div><a href="x"><img' in shown


def test_internal_members_are_left_out_of_the_reference() -> None:
    internal = [(c, m) for c, members in api.INTERNAL.items() for m in members.split()]
    assert all(hasattr(getattr(api.gnc_opt, c), m) for c, m in internal)
    page = api.pages()["api/gnc_opt.planning.problem.md"]
    assert re.search(r"::: \S+\.Problem\n    options:\n      filters: .*clear_cache", page)
    assert "|known_ends|" in page


def test_names_in_tables_break_after_their_parts() -> None:
    shown = hooks.on_post_page("<td><code>go.some_name(x)</code></td><p><code>some_name</code></p>")
    assert shown == "<td><code>go.some_<wbr>name(<wbr>x)</code></td><p><code>some_name</code></p>"
    shown = hooks.on_post_page("<article><pre>1e-3</pre>1e-3, 5 %</article>")
    assert shown == '<article><pre>1e-3</pre><span class="unbroken">1e-3</span>, 5&nbsp;%</article>'


def test_a_page_of_the_reference_begins_with_its_main_name() -> None:
    for package, name in (("model", "Model"), ("planning.problem", "Problem"), ("planning", "solve")):
        first = re.search(r"(?m)^::: \S+\.(\w+)$", api.pages()[f"api/gnc_opt.{package}.md"])
        assert first is not None and first[1] == name


def test_the_reference_begins_with_what_users_need_first() -> None:
    shown = re.findall(r"(?m)^\| \[`go\.(\w+)`\]", api.pages()["api/index.md"])
    assert shown[:5] == ["Model", "Problem", "solve", "Solution", "verify"]


def test_every_problem_has_its_exhibit() -> None:
    pages = gallery.pages(pictures=False)
    assert set(pages) == {f"gallery/{name}.md" for name in (each.name for each in list_examples())}
    assert "**Reference**: 5.457865264 s" in pages["gallery/zermelo.md"]
    assert "Tolerance: 1e-08 s." in pages["gallery/zermelo.md"]
    assert (
        "58.34808 h, which **differs by 68 %**. [Optimality check](../problems.md): strict"
        in pages["gallery/gto_to_geo.md"]
    )
    assert "def headings()" in pages["gallery/zermelo.md"]
    assert "problems/rendezvous/model.py" in pages["gallery/rendezvous.md"]


def test_every_page_of_the_gallery_is_in_the_navigation() -> None:
    """A page outside of it has no menu."""
    systems: list[Any] = []
    nav = [{"Examples": [{gallery.SYSTEMS: systems}]}, {"API": []}, {"Project": []}]
    hooks.on_config(types.SimpleNamespace(nav=nav))  # type: ignore[arg-type]
    assert set(re.findall(r"gallery/\w+\.md", str(nav))) == set(gallery.pages(pictures=False))
    assert "gallery/rendezvous.md" in str(systems)


def test_a_picture_shows_states_and_controls() -> None:
    zermelo = next(each for each in list_examples() if each.name == "zermelo")
    found = gallery.pictures(zermelo)
    assert set(found) == {"gallery/zermelo_states.svg", "gallery/zermelo_controls.svg"}
    assert all(svg.startswith(b"<?xml") and len(svg) < 200_000 for svg in found.values())


def test_a_problem_without_controls_or_without_a_plan_of_its_own_has_a_picture() -> None:
    kinds = {each.name: gallery.shown(each) for each in list_examples()}
    assert kinds["cannonball"] == ("states",)
    assert kinds["rendezvous_tracking"] == ("states", "controls")
    assert all("states" in kind for kind in kinds.values())


def test_the_first_page_leads_to_the_reference_and_the_gallery() -> None:
    """The README cannot: they are generated."""
    file = types.SimpleNamespace(src_uri="index.md", generated_by="hooks")
    place = types.SimpleNamespace(file=file, meta={})
    shown = hooks.on_page_markdown(README.text, place)
    assert "[API reference](api/index.md)" in shown and "[Gallery](problems.md)" in shown


@pytest.mark.parametrize(
    ("source", "place", "text", "shown"),
    [
        ("README.md", "index.md", "[a](docs/verdict.md)", "[a](verdict.md)"),
        ("README.md", "index.md", "![a](docs/rendezvous.svg)", "![a](rendezvous.svg)"),
        (
            "docs/problems.md",
            "problems.md",
            "[a](../problems/classics/zermelo.py)",
            "[a](gallery/zermelo.md)",
        ),
        ("docs/problems.md", "problems.md", "[`a`](../problems/rendezvous)", "[`a`](gallery/rendezvous.md)"),
        ("docs/learn/a.md", "learn/a.md", "[a](../verdict.md#b)", "[a](../verdict.md#b)"),
        ("docs/learn/a.md", "learn/a.md", "[a](#b)", "[a](#b)"),
        ("CONTRIBUTING.md", "development/contributing.md", "[a](docs/b.md)", "[a](../b.md)"),
        ("README.md", "index.md", "[a](CONTRIBUTING.md)", "[a](development/contributing.md)"),
        ("README.md", "index.md", "[a](CITATION.cff)", "[a](development/citation.md)"),
        ("README.md", "index.md", "[a](LICENSE)", "[a](development/licence.md)"),
        ("README.md", "index.md", "[a](pyproject.toml)", "a"),
    ],
)
def test_links_of_the_repository_lead_to_pages(source: str, place: str, text: str, shown: str) -> None:
    assert hooks.relinked(text, source, place) == shown


def test_titles_of_hits_name_the_class_of_a_member() -> None:
    place = "api/gnc_opt.html#gnc_opt.planning.problem.phase.Phase"
    assert hooks.search_title("Phase  <code>dataclass</code>", place) == "Phase"
    assert hooks.search_title("duration  <code>property</code>", f"{place}.duration") == "Phase.duration"
    address = "api/gnc_opt.html#gnc_opt.planning.optimal_control_solver.solve"
    assert hooks.search_title("solve", address) == "solve"
    assert hooks.search_title("Use <code>solve</code>", "howto/a.html#use") == "Use <code>solve</code>"
    assert hooks.american_spellings("Linearised about a neighbour.") == " linearized neighbor"


def test_no_link_of_a_page_is_lost() -> None:
    """Whatever a page links to is shown, but for licence, citation and the like."""
    for page in PAGES:
        folder = Path(page.name).parent
        lost = [
            t
            for t in page.links
            if hooks.shown_at(str((ROOT / folder / t).resolve().relative_to(ROOT))) is None
        ]
        assert set(lost) <= {"CITATION.cff", "LICENSE"}, page.name


def test_formulas_of_docstrings_stand_between_dollars() -> None:
    inline = "With :math:`a\n b` so\n\n.. math:: x = y, \\qquad\n   z = 1 .\n\nand"
    assert " ".join(sphinx_math.dollars(inline).split()) == "With $a b$ so $$ x = y, \\qquad z = 1 . $$ and"
    aligned = ".. math::\n   a &= b \\\\\n   c &= d\n\nthen."
    shown = "$$ \\begin{split} a &= b \\\\ c &= d \\end{split} $$ then."
    assert " ".join(sphinx_math.dollars(aligned).split()) == shown


def test_parameters_described_together_have_their_own_types() -> None:
    text = "Solve.\n\nParameters\n----------\na : int\n    Text.\nb, c\n    As `f`.\n\nRaises\n------\nX, Y\n    No."
    shown = text.replace("b, c\n", "b\n    As `f`.\nc\n")
    assert sphinx_math.separate_parameters(text) == shown


def test_formulas_become_mathml() -> None:
    shown = hooks.on_page_content(
        '<span class="arithmatex">\\(\\operatorname{ab}&lt;-a\\Big(\\sin y\\Big)\\)</span>'
    )
    assert shown.startswith("<math") and "arithmatex" not in shown and "<mi>ab</mi>" in shown
    assert re.search(r"<mi>sin</mi><mspace [^>]*><mi>y</mi>", shown)
    assert '<mo form="prefix">&#x02212;</mo><mi>a</mi><mrow><mo stretchy="true"' in shown
    assert hooks.separate_formulas(r"x = {a \quad b}, \qquad y = 1") == [r"x = {a \quad b}, ", " y = 1"]


def test_long_signatures_and_defaults_made_by_functions_are_left_out() -> None:
    line = '<span id="line-0-1"><span class="nf">Run</span>(\n'
    begin = f'<div class="doc-signature highlight"><pre><span></span><code>{line}'
    made = '<span class="o">=</span> <span class="p">(</span><span class="k">lambda</span><span>: list())(),</span>\n'
    shown = hooks.on_page_content(f"{begin}samples {made})</code></pre></div>")
    assert "lambda" not in shown and "<span>...</span>,\n)" in shown
    assert not hooks.on_page_content(begin + "x,\n" * 20 + ")</code></pre></div>")


def test_an_enumeration_lists_its_values() -> None:
    griffe = pytest.importorskip("griffe")
    code = (
        'from enum import Enum\nclass Kind(Enum):\n    """Kind of an arc."""\n    LOWER = 1\n    UPPER = 2\n'
    )
    extensions = griffe.load_extensions(sphinx_math.SphinxMath)
    module = griffe.visit("kinds", filepath=Path("kinds.py"), code=code, extensions=extensions)
    assert module["Kind"].docstring.value == "Kind of an arc.\n\nValues: `LOWER`, `UPPER`."


def item(name: str, text: str) -> str:
    """A name with its description as mkdocstrings lists it."""
    description = f'<div class="doc-md-description"> {text} </div>'
    return f'<li class="doc-section-item field-body"> <b>{name}</b> – {description} </li>'


def test_parameters_without_a_description_are_listed() -> None:
    title = '<p><span class="doc-section-title">Parameters:</span></p>'
    shown = hooks.on_page_content(f"{title} <ul> {item('problem', '')} {item('mesh', '<p>Text.</p>')} </ul>")
    assert "<b>problem</b> </li>" in shown and "<b>mesh</b> –" in shown


def test_attributes_without_a_description_are_left_out() -> None:
    title = '<p><span class="doc-section-title">Attributes:</span></p>'
    shown = hooks.on_page_content(f"{title} <ul> {item('name', '')} {item('size', '<p>Metres.</p>')} </ul>")
    assert "name" not in shown and "Metres" in shown and "Attributes" in shown
    assert not hooks.on_page_content(f"{title} <ul> {item('name', '')} </ul>").strip()


def test_code_of_a_page_fits_its_column() -> None:
    """A window of 1280 pixels shows 120 columns in the smaller letters of long lines."""
    lines = [(page.name, line) for page in PAGES for block in page.blocks for line in block.code.splitlines()]
    assert len(lines) > 1000 and not [(name, line) for name, line in lines if len(line) > 120]


def test_nothing_is_loaded_from_elsewhere() -> None:
    """The theme's fonts and the script of the offline search would come from other servers."""
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert re.search(r"(?m)^  font: false", settings)
    assert f"polyfills: [{hooks.SEARCH_FROM_FILES}]" in settings
    assert not re.search(r"https?://", settings)


def test_modules_of_the_reference_have_titles() -> None:
    """A title is the beginning of the module's docstring, not the name of its file."""
    page = api.pages()["api/gnc_opt.control.md"]
    assert "## Export of a controller as self-contained C99\n" in page
    headings = re.findall(r"(?m)^## (.+)$", "\n".join(api.pages().values()))
    assert all(heading[0] == "[" or heading[0].isupper() for heading in headings)
    assert not [page for page, text in api.pages().items() if "docs/" in text]  # a folder that readers lack
    assert "[Mesh refinement](../refinement.md)" in api.pages()["api/gnc_opt.planning.solution.md"]
    assert not re.findall(
        r"(?m)^\| \[.*\| *\|$", "\n".join(api.pages().values())
    )  # names without a description


def test_pictures_of_pages_are_those_of_their_examples() -> None:
    """Every figure that an example saves and its page shows is in the folder of the pages."""
    drawn = [figures.shown_figures(page.read_text(encoding="utf-8")) for page in figures.pages_with_figures()]
    assert len([name for names in drawn for name in names]) >= 10
    assert all((ROOT / "docs" / name).exists() for names in drawn for name in names)
