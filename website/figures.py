"""Pictures of the pages: each page's examples are run, and the figures that they save are copied to ``docs``.

    python -m website.figures [PAGE ...]

Without arguments all pages that save figures are drawn, and the picture of the first page (`website.overview`).
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

from website import overview

DOCS = Path(__file__).parents[1] / "docs"

_EXAMPLE = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
_SAVED = re.compile(r"save_figure\(.*\"(\w+\.svg)\"\)")
_PICTURE = re.compile(r"^!\[.*\]\((?:\.\./)?(\w+\.svg)\)$", re.MULTILINE)


def pages_with_figures() -> list[Path]:
    """Return the pages whose examples save figures."""
    return [page for page in sorted(DOCS.rglob("*.md")) if "save_figure(" in page.read_text(encoding="utf-8")]


def draw(page: Path) -> list[str]:
    """Run the examples of a page, copy the figures that the page shows to ``docs``, and return their names."""
    text = page.read_text(encoding="utf-8")
    examples = "\n".join(_EXAMPLE.findall(text))
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(examples, str(page), "exec"), {"__name__": page.stem})
        finally:
            os.chdir(here)
        for name in shown_figures(text):
            shutil.copy(Path(folder) / name, DOCS / name)
    return shown_figures(text)


def shown_figures(text: str) -> list[str]:
    """Return the figures that the examples of a page save and the page shows."""
    saved = set(_SAVED.findall(text))
    return [name for name in _PICTURE.findall(text) if name in saved]


def main(arguments: Sequence[str]) -> int:
    """Draw the pictures of the pages named, or all."""
    for page in map(Path.resolve, map(Path, arguments)) if arguments else pages_with_figures():
        print(page.relative_to(DOCS), *draw(page))
    if not arguments:
        overview.save(DOCS / "overview.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
