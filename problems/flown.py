"""Flown comparisons: a plan and a published law on the same disturbed plant, with the same errors and limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from gnc_opt.errors import GncOptError, did_you_mean
from gnc_opt.problem_file import parse_setting
from problems.comparison import Row, compare, remark

Conditions = TypeVar("Conditions")


@dataclass(frozen=True)
class Flight:
    """What a flight in closed loop is worth.

    Attributes
    ----------
    time : float
        Until it is settled, s; infinite if it never is.
    effort : float
        What it costs, in the system's unit.
    miss : float
        How far it is off when it is judged, in the system's unit.
    """

    time: float
    effort: float
    miss: float


def flight_rows(
    what: str,
    measures: tuple[str, str, str],
    plan: Flight,
    law: Flight,
    known: tuple[Flight, Flight] | None,
    *,
    relative: float = 0.01,
    note: str = "",
) -> list[Row]:
    """Return a row for each measure: the plan's, the published law's, and their ratio.

    Parameters
    ----------
    what : str
        Which plan.
    measures : tuple of 3 str
        What time, effort and miss are, with their units.
    plan, law : Flight
    known : tuple of 2 Flight, optional
        The same, computed independently for these very conditions; without, nothing is judged.
    relative : float
        Tolerance of all.
    note : str
        Beside the first row.
    """
    rows = []
    for i, measure in enumerate(measures):
        ours = _with_ratio(astuple(plan)[i], astuple(law)[i])
        quantity, told = f"{what}, flown: {measure}; published law; ratio", note if i == 0 else ""
        if known is None:
            rows.append(remark(quantity, ours, note=told))
        else:
            expected = _with_ratio(astuple(known[0])[i], astuple(known[1])[i])
            rows.append(compare(quantity, expected, ours, relative=relative, note=told))
    return rows


def _with_ratio(plan: float, law: float) -> tuple[float, float, float]:
    return plan, law, plan / law if np.isfinite(law) and law else float("nan")


def with_settings(conditions: Conditions, settings: Sequence[str]) -> Conditions:
    """Return a dataclass of conditions with some of its fields changed, each by ``NAME=VALUE``.

    Raises
    ------
    ProblemFileError
        A setting is not of the form ``NAME=VALUE``.
    GncOptError
        There is no such condition, or its value is of another kind.
    """
    told = {f.name: getattr(conditions, f.name) for f in fields(conditions)}  # type: ignore[arg-type]
    for text in settings:
        name, value = parse_setting(text)
        if name not in told:
            raise GncOptError(
                f"--set {text!r}: there is no condition '{name}': {did_you_mean(name, list(told))}"
            )
        told[name] = _of_kind(told[name], value, text)
    return replace(conditions, **told)  # type: ignore[type-var]


def _of_kind(default: Any, value: Any, text: str) -> Any:
    """Return a value as what its default is: whole numbers are floats too, lists tuples of the same length."""
    if isinstance(default, tuple) and isinstance(value, list) and len(value) == len(default):
        return tuple(_of_kind(d, v, text) for d, v in zip(default, value, strict=True))
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(default):
        raise GncOptError(f"--set {text!r} does not fit: the value has to be like {default!r}.")
    return value
