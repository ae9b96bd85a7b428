"""Prediction: where a solution goes when the numbers of its problem change a little."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.errors import GncOptError, ProblemWarning
from gnc_opt.problem.norms import restated
from gnc_opt.problem.problem import Problem
from gnc_opt.refine.sensitivity.kkt import Change, KktPoint
from gnc_opt.solution.covector import Iterate
from gnc_opt.solution.extract import extract_phases
from gnc_opt.solution.solution import Solution
from gnc_opt.solution.start import ProgramStart, program_start
from gnc_opt.transcription.scaling import scale_variables
from gnc_opt.transcription.transcription import Transcription, transcribe


@dataclass(frozen=True, eq=False)
class MovedSolution:
    """A solution moved to another problem of its family.

    Attributes
    ----------
    guess : Solution
        To start from.
    variables : array (n_variables,)
        Of the guess in its program, physical.
    scales : array (n_variables,)
    """

    guess: Solution
    variables: Array
    scales: Array

    def miss(self, found: Solution) -> float:
        """Return by how much the prediction was wrong: its largest error, in shares of the variables' scales."""
        here = _start(found.need_problem("compare"), found)[1].x
        if here.shape != self.variables.shape:
            return 0.0  # on another mesh, by a refinement: nothing to compare
        return float(np.max(np.abs(here - self.variables) / self.scales))


def predict(problem: Problem, last: Solution, before: Solution | None, ratio: float) -> MovedSolution:
    """Return where the solution is likely to go for ``problem``.

    By the sensitivities of the last solution, if both problems are variations of one another (`with_parameters`,
    `with_initial` and their like); else, or where they are not determined, along the line through the last two.

    Parameters
    ----------
    problem : Problem
        The next one.
    last, before : Solution
        Of the last problem and of the one before that.
    ratio : float
        Length of this step over that of the last one.
    """
    problem = restated(problem)
    transcription, start = _start(problem, last)
    change = _by_sensitivity(problem, last)
    if change is None and before is not None:
        earlier = program_start(transcription, problem, before).x
        change = ratio * (start.x - earlier)
    x = start.x if change is None or change.shape != start.x.shape else start.x + change
    box = transcription.variable_interval(problem)
    x = np.clip(x, box.lower, np.maximum(box.lower, box.upper))
    assert start.lam_x is not None and start.lam_g is not None, "a solution has multipliers"
    phases, _ = extract_phases(transcription, problem, Iterate(x, start.lam_x, start.lam_g))
    values = x[transcription.parameter_places]
    guess = replace(last, phases=phases, parameter_values=values, problem=problem.frozen())
    return MovedSolution(guess, x, scale_variables(transcription, problem, start.x))


def _start(problem: Problem, solution: Solution) -> tuple[Transcription, ProgramStart]:
    meshes = {name: leg.mesh for name, leg in solution.phases.items()}
    transcription = transcribe(problem, meshes, solution.scheme)
    return transcription, program_start(transcription, problem, solution)


def _by_sensitivity(problem: Problem, last: Solution) -> Array | None:
    """Return the first-order change of the variables (n_variables,), or None where it is not known."""
    old = last.need_problem("differentiate")
    if problem.builds is not old.builds:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ProblemWarning)  # one-sided derivatives predict, too
            point = KktPoint(last)
            return point.respond(_difference(point.transcription, old, problem)).variables
    except GncOptError:
        return None


def _difference(transcription: Transcription, old: Problem, new: Problem) -> Change:
    """Return the difference between the data of two problems; limits that are not finite do not move."""

    def moved(before: Array, after: Array) -> Array:
        finite = np.isfinite(before) & np.isfinite(after)
        return np.where(finite, np.where(finite, after, 0.0) - np.where(finite, before, 0.0), 0.0)

    here, there = transcription.variable_interval(old), transcription.variable_interval(new)
    rows, new_rows = transcription.row_interval(old), transcription.row_interval(new)
    lower, upper = moved(here.lower, there.lower), moved(here.upper, there.upper)
    row_lower, row_upper = moved(rows.lower, new_rows.lower), moved(rows.upper, new_rows.upper)
    return Change(
        transcription.numbers(new) - transcription.numbers(old),
        np.where(lower != 0, lower, upper),
        np.where(row_lower != 0, row_lower, row_upper),
    )
