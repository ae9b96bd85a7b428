"""Pictures of the pages: each page's examples are run, and the figures that they save are copied to ``docs``.

    python -m website.figures [PAGE ...]

Pictures that no example saves are drawn by `website.drawings` from the names that the examples above them define.
Without arguments all pages with figures are drawn, and the picture of the first page (`website.overview`).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from gnc_opt.plot import save_figure
from website import drawings, overview

DOCS = Path(__file__).parents[1] / "docs"

_PIECE = re.compile(r"^```python\n(.*?)^```|^!\[.*\]\((?:\.\./)?(\w+\.svg)\)$", re.DOTALL | re.MULTILINE)
"""An example, or a picture."""

_SAVED = re.compile(r"save_figure\(.*\"(\w+\.svg)\"\)")


def pages_with_figures() -> list[Path]:
    """Return the pages with figures that are drawn here."""
    return [page for page in sorted(DOCS.rglob("*.md")) if shown_figures(page.read_text(encoding="utf-8"))]


def draw(page: Path) -> list[str]:
    """Run the examples of a page, write the figures that the page shows to ``docs``, and return their names."""
    text = page.read_text(encoding="utf-8")
    wanted, names, here = shown_figures(text), {"__name__": page.stem}, Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for example, picture in _PIECE.findall(text):
                if drawings.is_drawn_here(picture):
                    save_figure(drawings.draw(picture, names), picture)
                elif example:
                    with contextlib.redirect_stdout(io.StringIO()):
                        exec(compile(example, str(page), "exec"), names)
        finally:
            os.chdir(here)
        for name in wanted:
            shutil.copy(Path(folder) / name, DOCS / name)
    return wanted


def shown_figures(text: str) -> list[str]:
    """Return the figures of a page that its examples save, or that `website.drawings` draws."""
    saved = set(_SAVED.findall(text))
    pictures = [picture for _, picture in _PIECE.findall(text)]
    return [name for name in pictures if name in saved or drawings.is_drawn_here(name)]


def main(arguments: Sequence[str]) -> int:
    """Draw the pictures of the pages named, or all."""
    for page in map(Path.resolve, map(Path, arguments)) if arguments else pages_with_figures():
        print(page.relative_to(DOCS), *draw(page))
    if not arguments:
        overview.save(DOCS / "overview.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
