"""Pieces of HTML, for reports and notebooks: every text that goes in is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def table(titles: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table that scrolls by itself where the screen is narrow, or nothing if it has no rows."""
    lines = "".join(f"<tr>{_cells('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{_cells('th', titles)}</tr></thead>" if any(titles) else ""
    return f'<div class="wide"><table>{head}<tbody>{lines}</tbody></table></div>' if lines else ""


def heading(text: str) -> str:
    """Return a paragraph that stands out."""
    return f"<p><strong>{escape(text)}</strong></p>"


def preformatted(text: str) -> str:
    """Return lines whose columns stay where they are."""
    return f"<pre>{escape(text)}</pre>"


class Printed:
    """Base of results that notebooks show as `print` does."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return preformatted(str(self))


def _cells(tag: str, values: Iterable[object]) -> str:
    return "".join(f"<{tag}>{escape(str(value))}</{tag}>" for value in values)


GREEK_NAMES = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu"),
    *("nu", "xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta"),
    *("Lambda", "Xi", "Pi", "Sigma", "Phi", "Psi", "Omega"),
)
"""Names of variables that are typeset as Greek letters."""
