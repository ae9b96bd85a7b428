r"""Controls that active constraints determine: which directions are left to them.

Along an arc on which a constraint :math:`c(t, x) = 0` without controls is active, its time derivatives vanish too, and
the first in which controls appear, that of the order q of the constraint, determines as many of them as it has
independent gradients (Bryson, Denham & Dreyfus, AIAA J. 1(11), 1963; Hartl, Sethi & Vickson, SIAM Review 37(2), 1995,
sec. 2); a constraint with controls is its own, q = 0. Only what is tangent to these is left for H to determine. A
constraint that is met but does not push determines nothing.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array, Indices, Mask
from gnc_opt.model.evaluation import evaluate_columns
from gnc_opt.problem.functions import PhaseFunctions
from gnc_opt.solution.samples import NEGLIGIBLE, PhaseSamples
from gnc_opt.solution.spans import STILL
from gnc_opt.tolerances import ACTIVE, RANK

MOST_ORDER = 3
"""Orders of state constraints that are looked for."""


def left_free(s: PhaseSamples, free: Mask, unit: Array) -> list[Array]:
    """Return, for every sample, an orthonormal basis (m, k) of the free controls' directions that no constraint takes.

    Parameters
    ----------
    free : bool array (m, n_samples)
        Controls between their bounds.
    unit : array (m,)
        What a step of 1 in each control is.
    """
    rows, axes = _rows(s) * unit[None, :, None], np.eye(unit.size)
    bases = [axes[:, here] for here in free.T]
    if not rows.size:
        return bases
    for j, basis in enumerate(bases):
        taken = rows[:, :, j] @ basis
        taken = taken[np.any(taken != 0, axis=1)]
        if taken.size and np.all(np.isfinite(taken)):
            taken = taken / np.max(np.abs(taken), axis=1, keepdims=True)
            _, sizes, across = np.linalg.svd(taken, full_matrices=True)
            bases[j] = basis @ across[int(np.sum(sizes > RANK * sizes[0])) :].T
    return bases


def left(s: PhaseSamples, free: Mask, unit: Array, flat: float) -> tuple[Mask, Mask]:
    """Return which free controls have something left that H does not curve in (m, n_samples), and where all is left.

    Arguments as `left_free`; curvature of H that is at most ``flat`` is none. Where constraints take nothing, the
    curvature is not looked at.
    """
    if not _rows(s).size:
        return free, np.ones(s.times.size, dtype=bool)
    bases = left_free(s, free, unit)
    whole = np.array([basis.shape[1] for basis in bases]) == np.sum(free, axis=0)
    hessian = s.control_hessian * unit[:, None, None] * unit[None, :, None]
    for j in np.flatnonzero(~whole):
        bases[j] = _uncurved(bases[j], hessian[:, :, j], flat)
    return np.stack([np.linalg.norm(basis, axis=1) > RANK for basis in bases], axis=1), whole


def _uncurved(basis: Array, hessian: Array, flat: float) -> Array:
    """Return the directions of a basis in which a quadratic form is flat, or no number."""
    reduced = basis.T @ hessian @ basis
    if not reduced.size or not np.all(np.isfinite(reduced)):
        return basis
    values, vectors = np.linalg.eigh(0.5 * (reduced + reduced.T))
    return np.asarray(basis @ vectors[:, np.abs(values) <= flat])


def _rows(s: PhaseSamples) -> Array:
    """Gradients by the controls of what active constraints keep at zero (n, m, n_samples); zero where inactive."""
    leg = s.leg
    found = [np.zeros((0, leg.controls.size, s.times.size))]
    if leg.path_labels:
        # One that holds all along hardly moves: it is near by what could move it.
        scale = np.where(s.path_scale > STILL * s.path_reach, s.path_scale, s.path_reach)
        near = _near(s.functions.paths(s.times, s.x, s.u), leg.path_bounds, scale)
        found.append(s.functions.path_control_jacobian(s.times, s.x, s.u) * near[:, None])
    density = NEGLIGIBLE * s.cost_scale / s.span
    on_state = _near(s.x, leg.state_bounds, s.state_scale)
    on_state &= np.abs(s.state_multiplier) * s.state_scale[:, None] > density
    on_path = np.zeros((len(leg.path_labels), s.times.size), dtype=bool)
    if s.pure_paths.size:
        pushes = np.abs(s.mu) * s.path_scale[:, None] > density
        on_path[s.pure_paths] = (near & pushes)[s.pure_paths]
    along = np.vstack([on_state, on_path])
    # A limit that is met at one sample is touched: its derivatives need not vanish there.
    beside = along & (np.roll(along, 1, axis=1) | np.roll(along, -1, axis=1))
    chosen = np.flatnonzero(np.any(beside, axis=1))
    if chosen.size:
        gradients = _order_gradients(s.functions, chosen)
        numbers = np.concatenate([s.functions.weights, s.functions.p, s.functions.q])
        flat = evaluate_columns(gradients, s.times.size, s.times[None], s.x, s.u, numbers)
        rows = flat.reshape(chosen.size, leg.controls.size, s.times.size)
        found.append(rows * beside[chosen][:, None])
    return np.concatenate(found)


def _near(values: Array, box: Any, scale: Array) -> Mask:
    at_lower, at_upper = box.near(values, ACTIVE * scale)
    return np.asarray(at_lower | at_upper)


def _order_gradients(functions: PhaseFunctions, chosen: Indices) -> Any:
    """Gradients by u of the first time derivatives, of states and paths, in which it appears (n * m, row by row)."""
    rates = functions.functions["rates"]
    t, x, u, lam, mu = (ca.SX.sym("v", rates.size1_in(i)) for i in range(5))
    numbers = [ca.SX.sym("v", rates.size1_in(i)) for i in range(5, 8)]
    f = rates(t, x, u, lam, mu, *numbers)
    values = ca.vertcat(x, functions.functions["paths"](t, x, u, lam, mu, *numbers))
    along, flow = ca.vertcat(t, x), ca.vertcat(1, f)
    gradients = []
    for i in chosen:
        value = values[int(i)]
        for _ in range(MOST_ORDER):
            value = ca.jtimes(value, along, flow)
            if ca.depends_on(value, u):
                break
        gradients.append(ca.densify(ca.jacobian(value, u)))
    return ca.Function("held", [t, x, u, ca.vertcat(*numbers)], [ca.vec(ca.vertcat(*gradients).T)])
