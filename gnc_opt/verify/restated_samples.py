"""Samples of controls as a problem was stated, in those that it is solved in: parts, magnitudes and directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.evaluation import evaluate_columns
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.problem import Problem
from gnc_opt.solution.extract import model_parameters
from gnc_opt.tolerances import AT_LIMIT
from gnc_opt.verify.trajectory_fit import Samples


def restated_samples(
    problem: Problem, twin: Problem, samples: Mapping[str, Samples], q: Array
) -> dict[str, Samples]:
    """Return samples of a problem as those of ``restated(problem)``, of which q are the first parameters."""
    return {name: _of_phase(problem, twin.phases[name], own, q) for name, own in samples.items()}


def _of_phase(problem: Problem, leg: Phase, own: Samples, q: Array) -> Samples:
    if leg.restatement is None:
        return own
    stated = leg.restatement.model
    arguments = [*stated.arguments(), problem.parameter_symbols()]
    values = ca.densify(problem.bind(leg, leg.restatement.values))
    function = ca.Function("restated", arguments, [values])
    p = model_parameters(problem, problem.phases[leg.name], q)
    with np.errstate(invalid="ignore", divide="ignore"):
        u = evaluate_columns(function, own.t.size, own.t[None], own.x, own.u, p, q)
    controls = leg.model.controls
    for vector in leg.vectors:
        size, direction = u[controls.slice(vector.magnitude)][0], controls.slice(vector.direction)
        lost = size <= AT_LIMIT * np.max(size)
        u[direction] = _held(np.where(lost, np.nan, u[direction]))
    return replace(own, u=u)


def _held(directions: Array) -> Array:
    """Directions (n, n_times) that go on where there are none: as they were before, at first as they will be."""
    known = np.flatnonzero(np.all(np.isfinite(directions), axis=0))
    if not known.size:
        return np.repeat(np.eye(directions.shape[0])[:, :1], directions.shape[1], axis=1)
    before = np.searchsorted(known, np.arange(directions.shape[1]), side="right") - 1
    return np.asarray(directions[:, known[np.maximum(before, 0)]])
