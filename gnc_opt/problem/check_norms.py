"""Warnings of what controls do by hand that cannot be restated as norms: its derivatives fail where they are zero."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np

from gnc_opt.errors import warn_user
from gnc_opt.problem.check_values import Tried, try_along
from gnc_opt.problem.guess.trajectory import start_phase
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.statement import Statement

_FRACTIONS = np.linspace(0.2, 0.8, 4)
_REMEDY = (
    "if that is the norm of a vector, declare it with Model.vector_control() and limit it with bounds_norm()"
)


def warn_of_norms(problem: Statement, leg: Phase) -> None:
    """Issue a `ProblemWarning` for each of `norms_by_hand`."""
    for text in norms_by_hand(problem, leg):
        warn_user(f"{text}.")


def norms_by_hand(problem: Statement, leg: Phase) -> list[str]:
    """Return what is wrong with functions of controls, such as a norm, and what to write instead.

    Norms of controls that `restated` knows are none of these in a restated problem.

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
            texts.append(f"{tried.what} '{tried.rows[row]}' of {leg.where} has {what}: {_REMEDY}")
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
