"""Formatting of results: counts, HTML elements with escaped text, and JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from gnc_opt.argument_checks import StrictAttributes


class Html(str):
    """HTML text, which a table shows as it is."""


LONG_CELL = 30
"""Number of letters from which phones give the last column of a table more width."""


def format_html_table(titles: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table that scrolls horizontally on narrow screens; "" without rows."""
    rows = [tuple(row) for row in rows]
    kind = " text" * any(len(row) > 3 and len(str(row[-1])) > LONG_CELL for row in rows)
    lines = "".join(f"<tr>{_format_html_table_cells('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{_format_html_table_cells('th', titles)}</tr></thead>" if any(titles) else ""
    return f'<div class="wide{kind}"><table>{head}<tbody>{lines}</tbody></table></div>' if lines else ""


def pluralise_noun(number: int, noun: str) -> str:
    """Return "1 state", "2 states"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def format_percentage(share: float) -> str:
    """Return a share with two significant digits of it and of the remainder: "62.0 %", "99.92 %"."""
    rest = min(share, 1.0 - share)
    digits = min(max(1 - math.floor(math.log10(100.0 * rest)), 1), 4) if rest > 0.0 else 1
    return f"{100.0 * share:.{digits}f} %"


def read_status_explanations(kind: str) -> dict[str, str]:
    """Return remedies by status of a "solve" or "refinement" or by "condition", or statuses by "solver names"."""
    text = Path(__file__).with_name("status_remedies.json").read_text(encoding="utf-8")
    return dict(json.loads(text)[kind])


def format_html_heading(text: str) -> str:
    return f"<p><strong>{escape(text)}</strong></p>"


_UNIT = re.compile(r"([A-Za-z°%]+|\d+\.\d+)(?:\^(-?[\d.]+))?")


def format_unit_quotient(unit: str, other: str) -> str:
    """Return the unit of a derivative, e.g. "s/(m/s)" from "s" and "m/s", or "1/N" from "" and "N".

    The quotient of a product or of a quotient has no common factors: "m/(s^2 N)" from "m/s/s" and "N".
    """
    if not other:
        return unit
    powers = (_parse_unit_powers(unit), _parse_unit_powers(other)) if set(unit) & set(" /") else ()
    if not powers or None in powers:
        divisor = f"({other})" if set(other) & set(" /*") else other
        return f"{unit or '1'}/{divisor}"
    total = dict(powers[0] or {})
    for name, power in (powers[1] or {}).items():
        total[name] = total.get(name, 0.0) - power
    above = " ".join(n if p == 1.0 else f"{n}^{p:g}" for n, p in total.items() if p > 0.0)
    below = [n if p == -1.0 else f"{n}^{-p:g}" for n, p in total.items() if p < 0.0]
    divisor = f"({' '.join(below)})" if len(below) > 1 else "".join(below)
    return f"{above or '1'}/{divisor}" if below else above


def _parse_unit_powers(unit: str) -> dict[str, float] | None:
    """Return the power of each factor of a unit such as "N m/s^2" or "s/(N m)"; None if it has another form."""
    powers: dict[str, float] = {}
    for k, part in enumerate(re.sub(r"\(([^()/]*)\)", r"\1", unit).split("/")):
        for factor in part.split():
            found = _UNIT.fullmatch(factor)
            if found is None and factor != "1":
                return None
            if found is not None:
                powers[found[1]] = powers.get(found[1], 0.0) + float(found[2] or 1.0) * (-1.0 if k else 1.0)
    return powers


def simplify_time_integral_unit(unit: str) -> str:
    """Return the unit of a time integral without a common factor: "m/s" for "m/s^2 s", "rad" for "rad/s s"."""
    shorter = re.sub(r"/s s$", "", re.sub(r"/s\^2 s$", "/s", unit))
    return "" if shorter == "1" else shorter


def format_html_preformatted(text: str) -> str:
    return f"<pre>{escape(text)}</pre>"


class PrintableResult(StrictAttributes):
    """Base class of results with equal output in notebooks and by `print`; subclasses define ``__str__``."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"<{str(self).splitlines()[0]}>"

    def _repr_html_(self) -> str:
        return format_html_preformatted(str(self))


def _format_html_table_cells(tag: str, values: Iterable[object]) -> str:
    texts = (value if isinstance(value, Html) else escape(str(value)) for value in values)
    return "".join(f"<{tag}>{text}</{tag}>" for text in texts)


def convert_to_json_values(value: Any) -> Any:
    """Return JSON values: NumPy scalars and arrays converted, non-finite numbers as None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: convert_to_json_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert_to_json_values(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def build_attribute_dict(value: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}


def format_json(content: Any, indent: int | None = 2) -> str:
    """Return `convert_to_json_values` of content as text with a trailing newline."""
    return (
        json.dumps(convert_to_json_values(content), indent=indent, ensure_ascii=False, allow_nan=False) + "\n"
    )


GREEK_NAMES = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu"),
    *("nu", "xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta"),
    *("Lambda", "Xi", "Pi", "Sigma", "Phi", "Psi", "Omega"),
)
"""Variable names that are typeset as Greek letters."""


def split_symbol_and_index(label: str) -> tuple[str, str]:
    """Return symbol and index of a name: "r" and "L,1" of "r_L[0]", "inertia" and "3" of "inertia_3" or "inertia[2]".

    A name of several letters keeps an ending of more than two characters: "mean_motion". A letter before x, y, z or a
    number has an index too: "v" and "x" of "vx". "lam" is "lambda".
    """
    name, _, index = label.partition("[")
    name = re.sub(r"^lam(?=_|$)", "lambda", re.sub(r"^([A-Za-z])([xyz]|\d+)$", r"\1_\2", name))
    base, _, subscript = name.partition("_")
    if len(base) > 1 and base not in GREEK_NAMES:
        base, _, subscript = name.rpartition("_")
        base, subscript = (base, subscript) if base and len(subscript) <= 2 else (name, "")
    marks = [subscript.replace("_", ",")] if subscript else []
    return base, ",".join(marks + ([str(int(index[:-1]) + 1)] if index else []))
