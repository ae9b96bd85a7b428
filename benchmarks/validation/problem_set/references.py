"""Comparing a solution with what a problem document gives as reference: objective and costates.

Costates of the references belong to the problem's own sense (dJ/dx for a maximised J too), those of gnc_opt to the
minimised functional: for a maximised problem the sign differs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gnc_opt as go
from benchmarks.validation.problem_set.reader import evaluate, read_constants

Array = NDArray[np.float64]

MINOR = 1e-3
"""Costates whose share of the cost, |costate| * |state|, is less than this part of the largest one are compared
with that part instead of their own size: a costate of exactly zero has no relative error."""

SAMPLES = 61
"""Times at which closed forms are compared."""


def relative_error(objective: float, reference: float) -> float:
    """Return |objective - reference|, relative unless the reference is zero."""
    return abs(objective - reference) / (abs(reference) if reference != 0 else 1.0)


def initial_costate_error(document: Mapping[str, Any], solution: go.Solution) -> float | None:
    """Worst relative error of the costates at the start of the first phase against ``dJ_dx0``; None without it."""
    given = {k: v for k, v in (document.get("dJ_dx0") or {}).items() if v is not None}
    if not given:
        return None
    leg = next(iter(solution.phases.values()))
    wanted = np.array([[float(v)] for v in given.values()])
    found = np.array([[float(leg.costate(name)(leg.initial_time))] for name in given])
    states = np.array([leg.state(name)(leg.sample_times()) for name in given])
    return float(np.max(costate_errors(_sense(solution) * found, wanted, states)))


def costate_error_along(path: Path, solution: go.Solution) -> float | None:
    """Mean over time of the relative errors of the costates against a reference trajectory, worst state and phase.

    The mean, since costates jump where state constraints begin and end, and a reference of 61 points does not say
    where. Times are compared by their fraction of the phase. None if there is no file.
    """
    if not path.exists():
        return None
    worst = 0.0
    for leg, reference in zip(solution.phases.values(), json.loads(path.read_text())["phases"], strict=True):
        times = np.asarray(reference["t"])
        fractions = (times - times[0]) / (times[-1] - times[0])
        at = np.clip(leg.initial_time + fractions * leg.duration, leg.initial_time, leg.final_time)
        wanted = {name: np.asarray(values, dtype=float) for name, values in reference["lam"].items()}
        worst = max(worst, _mean_error(solution, leg, wanted, at))
    return worst


def closed_form_costate_error(document: Mapping[str, Any], solution: go.Solution) -> float | None:
    """Mean over time of the relative errors of the costates against ``closed``, worst state and phase.

    Its keys are ``lam_<state>`` in the first phase, or ``phase<k>.lam_<state>``, its values expressions in t and the
    constants. None without any.
    """
    constants = read_constants(document)
    worst: float | None = None
    for k, leg in enumerate(solution.phases.values(), 1):
        prefixes = (f"phase{k}.lam_", "lam_") if k == 1 else (f"phase{k}.lam_",)
        forms = {
            key.removeprefix(prefix): expression
            for key, expression in (document.get("closed") or {}).items()
            for prefix in prefixes
            if key.startswith(prefix)
        }
        at = np.linspace(leg.initial_time, leg.final_time, SAMPLES)
        wanted = {
            name: np.array([float(evaluate(form, {**constants, "t": float(t)}, name)) for t in at])
            for name, form in forms.items()
            if name in leg.states
        }
        if wanted:
            worst = max(worst or 0.0, _mean_error(solution, leg, wanted, at))
    return worst


def _mean_error(
    solution: go.Solution, leg: go.PhaseSolution, wanted: Mapping[str, Array], at: Array
) -> float:
    """Mean over the times ``at`` (n_times,) of the errors of a phase's costates, worst state."""
    found = np.array([leg.costate(name)(at) for name in wanted])
    states = np.array([leg.state(name)(at) for name in wanted])
    errors = costate_errors(_sense(solution) * found, np.array(list(wanted.values())), states)
    return float(np.max(np.mean(errors, axis=1)))


def costate_errors(found: Array, wanted: Array, states: Array) -> Array:
    """Return the errors of costates, relative to each one's size or to `MINOR` of the largest share.

    Parameters
    ----------
    found, wanted, states : array (n_states, n_times)

    Returns
    -------
    array (n_states, n_times)
    """
    size = np.max(np.abs(wanted), axis=1)
    reach = np.max(np.abs(states), axis=1)
    reach = np.where(reach > 1e-9, reach, 1.0)
    least = MINOR * np.max(size * reach) / reach
    scale = np.maximum(size, least)
    return np.asarray(np.abs(found - wanted) / np.where(scale > 0, scale, 1.0)[:, None])


def _sense(solution: go.Solution) -> float:
    return -1.0 if solution.maximised else 1.0
