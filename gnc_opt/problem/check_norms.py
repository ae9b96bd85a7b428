"""Warnings of norms of controls that are written by hand: their derivatives vanish, or do not exist, at zero."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.errors import warn_user
from gnc_opt.model.graph import nodes_of
from gnc_opt.problem.check_values import Tried, try_along
from gnc_opt.problem.guess.trajectory import start_phase
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement
from gnc_opt.tolerances import ROUNDING

_FRACTIONS = np.linspace(0.2, 0.8, 4)
_UNKNOWN = (
    "if that is the norm of a vector, declare it with Model.vector_control() and limit it with bounds_norm()"
)


def warn_of_norms(problem: Statement, leg: Phase) -> None:
    """Issue a `ProblemWarning` for each of `norms_by_hand`."""
    for text in norms_by_hand(problem, leg):
        warn_user(f"{text}.")


def norms_by_hand(problem: Statement, leg: Phase) -> list[str]:
    """Return what is wrong with norms of controls that are written by hand, and what to write instead.

    Derivatives by the controls fail if controls are zero: of a norm they do not exist there, and of a limit such as
    ``T @ T <= d**2`` they are all zero, so that the Jacobian of the constraints is singular where an optimum coasts. A
    lower limit has a hole around zero, from which no derivative leads out if a guess is there.
    """
    start = start_phase(leg, _FRACTIONS, perturbed=False)
    times = start.times[0] + _FRACTIONS * (start.times[1] - start.times[0])
    q = np.concatenate([*problem.parameter_guess.values(), np.zeros(0)])
    box = leg.numbers.controls
    still = np.clip(np.zeros_like(start.controls), box.lower[:, None], box.upper[:, None])
    guessed = try_along(problem, leg, times, start.states, start.controls, q)
    texts = []
    for kind, tried in try_along(problem, leg, times, start.states, still, q).items():
        for row, what in _offences(leg, tried, guessed[kind]):
            remedy = _remedy(leg, tried, row)
            texts.append(f"{tried.what} '{tried.rows[row]}' of {leg.where} has {what}: {remedy}")
    return texts


def _offences(leg: Phase, tried: Tried, guessed: Tried) -> Iterator[tuple[int, str]]:
    """Yield rows, and what is wrong with them where all controls are zero, and at the guess."""
    n = leg.model.states.size
    columns = slice(n, n + leg.model.controls.size)
    by_controls = tried.derivatives[:, columns]
    finite = np.all(np.isfinite(tried.values), axis=1)
    for row in np.flatnonzero(finite & ~np.all(np.isfinite(by_controls), axis=(1, 2))):
        yield int(row), "no derivative where controls are zero"
    if tried.what != "path constraint":  # what follows is of limits
        return
    box, controls = leg.path_interval(), leg.model.symbols("control")
    depends = np.array(ca.which_depends(leg.path_expression(), controls, 1, True))
    flat = depends & np.all(by_controls == 0, axis=(1, 2))
    below, above = tried.values < box.lower[:, None], tried.values > box.upper[:, None]
    at_limit = np.all((tried.values == box.lower[:, None]) | (tried.values == box.upper[:, None]), axis=1)
    for row in np.flatnonzero(flat & at_limit):
        yield (
            int(row),
            "its limit, and no slope, where controls are zero, so that the solver's Jacobian is singular",
        )
    stuck = flat & np.any(below | above, axis=1) & np.all(guessed.derivatives[:, columns] == 0, axis=(1, 2))
    for row in np.flatnonzero(stuck):
        yield (
            int(row),
            "no slope at the guess, where controls are zero and its limits are left, so that nothing leads inside",
        )


# --- what to write instead --------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Norm:
    """A norm in an expression: factor * norm**power + what these controls do not appear in."""

    places: tuple[int, ...]
    power: int

    @classmethod
    def in_(cls, expression: Any, controls: Any) -> _Norm | None:
        """Return the norm that an expression has as a square, or else as a root; None if there is none."""
        squared = _squares(expression, controls)
        if squared:
            return cls(squared, 2)
        for node in nodes_of(expression):
            if node.op() == ca.OP_SQRT:
                inside = _squares(node.dep(0), controls)
                if inside:
                    return cls(inside, 1)
        return None


def _squares(expression: Any, controls: Any) -> tuple[int, ...]:
    """Return the controls whose squares an expression holds with one constant factor, and which are nowhere else."""
    hessian, gradient = ca.hessian(expression, controls)
    slopes = ca.substitute(gradient, controls, ca.SX.zeros(controls.numel()))
    groups: dict[float, list[int]] = {}
    for i in range(controls.numel()):
        row = ca.sparsify(hessian[i, :])
        if row.nnz() == 1 and row.is_constant() and slopes[i].is_zero():
            factor = float(ca.DM(row[0, i]))
            groups.setdefault(factor, []).append(i)
    spheres = [tuple(places) for factor, places in groups.items() if factor != 0 and len(places) > 1]
    return max(spheres, key=len, default=())


def _remedy(leg: Phase, tried: Tried, row: int) -> str:
    """Return the lines to write in place of a norm."""
    expressions = {
        "the rate of state": leg.model.derivative(),
        "path constraint": leg.path_expression(),
        "integral": leg.integrand_expression(),
    }
    expression, controls = expressions[tried.what][row], leg.model.symbols("control")
    norm = _Norm.in_(expression, controls)
    if norm is None:
        return _UNKNOWN
    labels = leg.model.controls.labels
    whole = [v for v in leg.model.controls.variables if v.labels == tuple(labels[i] for i in norm.places)]
    name = whole[0].name if whole else "T"
    limit = _limit(leg, expression, row, norm) if tried.what == "path constraint" else None
    size = limit.of if limit and limit.of else f"{name}_norm"
    instead = f"control('{name}', ...)" if whole else ", ".join(labels[i] for i in norm.places)
    text = f"write {name}, {size} = model.vector_control('{name}', {len(norm.places)}) in place of {instead}"
    if tried.what != "path constraint":
        return f"{text}, and {size} where its norm stands"
    if limit is None:
        return f"{text}, and limit {size}, its norm, in this constraint"
    bounds = f"{leg.name}.bounds_norm({name}=({limit.least:.9g}, {limit.most:.9g}))"
    return f"{text}, and {bounds} in place of this constraint"


@dataclass(frozen=True)
class _Limit:
    """The range of a norm, and the control that limits it (``T @ T <= d**2``), if there is one."""

    least: float
    most: float
    of: str = ""


def _limit(leg: Phase, expression: Any, row: int, norm: _Norm) -> _Limit | None:
    """Return the range that a path constraint gives to a norm; None if that varies."""
    controls, box = leg.model.symbols("control"), leg.path_interval()
    others = [
        i for i in range(controls.numel()) if i not in norm.places and ca.depends_on(expression, controls[i])
    ]
    if len(others) > 1 or any(not ca.depends_on(controls, v) for v in ca.symvar(expression)):
        return None
    value = ca.Function("value", [controls], [expression])

    def along(size: float, other: float) -> float:
        u = np.zeros(controls.numel())
        u[norm.places[0]], u[others] = size, other
        return float(value(u))

    rest = along(0.0, 0.0)
    ends = np.array([box.lower[row] - rest, box.upper[row] - rest]) / (along(1.0, 0.0) - rest)
    if not others:
        least, most = np.maximum(np.sort(ends), 0.0) ** (1 / norm.power)
        return _Limit(float(least), float(most))
    alike = all(abs(along(s, s)) <= ROUNDING * abs(along(s, 0.0)) for s in (1.0, 3.0))
    if not alike or np.max(ends) != 0:
        return None
    (other,) = others
    own = leg.numbers.controls
    return _Limit(
        max(0.0, float(own.lower[other])), float(own.upper[other]), leg.model.controls.labels[other]
    )
