r"""Hierarchical sliding surfaces: several outputs steered by fewer controls.

Each output error has its own first surface, :math:`s_i = k_i e_i + \dot e_i`; the control drives their weighted sum

.. math:: S = \sum_i w_i s_i, \qquad \sigma = \Big(\frac{d}{dt} + k\Big)^{r-1} S ,

to zero, r the relative degree of S. The weights decide the zero dynamics on S = 0; unstable ones are refused.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_positive
from gnc_opt.control.control_limits import Limits
from gnc_opt.control.controller import Controller
from gnc_opt.control.decoupling import GROWTH, GUARD
from gnc_opt.control.input_output_linearization import (
    OutputErrors,
    Outputs,
    Pair,
    chain_errors,
    error_expressions,
)
from gnc_opt.control.reaching_laws import Boundary, Law
from gnc_opt.control.reference import Reference, read_plant
from gnc_opt.control.sliding_mode import SlidingOptions, surface_controller
from gnc_opt.control.super_twisting import SuperTwistingObserver
from gnc_opt.environment import one_thread
from gnc_opt.errors import DesignError
from gnc_opt.model.model import Model
from gnc_opt.model.variables import as_vector


@one_thread()
def design_hierarchical_sliding_mode(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    outputs: Outputs,
    slopes: ArrayLike,
    weights: Sequence[float],
    slope: float = 1.0,
    reaching: Law,
    boundary: Boundary,
    bound: float = 0.0,
    observer: SuperTwistingObserver | None = None,
    limits: Limits | None = None,
    dt: float | None = None,
    guard: float = GUARD,
    growth: float = GROWTH,
    name: str = "hierarchical sliding mode",
) -> Controller:
    """Return a sliding mode on a weighted sum of the surfaces of several outputs.

    Parameters
    ----------
    model : Model
        Affine in its controls.
    reference : Reference or array (n_states,)
        Its control should keep it on the model's dynamics: it is the feedforward.
    outputs : names, expressions or mapping
        Scalar outputs e_i whose rates no control enters.
    slopes : float or array (n_outputs,)
        k_i > 0, 1/s.
    weights : sequence (n_outputs,)
        w_i, with signs.
    slope : float
        k of the second level, 1/s; without effect where S has relative degree 1.
    bound : float
        Largest disturbance of the r-th derivative of S.
    reaching, boundary, observer, limits, dt, guard, growth
        As in `design_sliding_mode`.
    name : str

    Raises
    ------
    DesignError
        The zero dynamics on S = 0 are unstable (with their eigenvalue), and as `design_sliding_mode`.

    Examples
    --------
    >>> from gnc_opt.control import ConstantRate, SaturationLayer
    >>> crane = go.Model("trolley with a load")
    >>> s, w = crane.state("s", unit="m"), crane.state("w", unit="m/s")
    >>> angle, rate = crane.state("angle", unit="rad"), crane.state("rate", unit="rad/s")
    >>> push = crane.control("push", unit="m/s^2")
    >>> crane.ode({s: w, w: push, angle: rate, rate: -9.81 * angle - push})
    >>> law = go.design_hierarchical_sliding_mode(
    ...     *(crane, [0.0, 0.0, 0.0, 0.0]), outputs=("s", "angle"), slopes=[0.5, 1.0], weights=[1.0, -0.5],
    ...     reaching=ConstantRate(0.5), boundary=SaturationLayer(0.1),
    ... )
    >>> print(go.ClosedLoop(crane, law, dt=0.02).simulate([1.0, 0.0, 0.0, 0.0], tf=30.0).miss("s") < 0.05)
    True
    """
    reference = read_plant(model, reference, "design_hierarchical_sliding_mode")
    errors = hierarchical_errors(model, reference, outputs, slopes, weights)
    poles = np.full(
        errors.degrees[0] - 1, -read_positive(slope, "the slope k of the second level", DesignError)
    )
    return surface_controller(
        name,
        f"hierarchical sliding mode of '{model.name}'",
        errors,
        reference,
        [np.atleast_1d(np.poly(poles))[::-1].astype(float)],
        SlidingOptions(reaching, boundary, bound, observer, limits, dt, guard=guard, growth=growth),
    )


def hierarchical_errors(
    model: Model, reference: Reference, outputs: Outputs, slopes: ArrayLike, weights: Sequence[float]
) -> OutputErrors:
    """Return S as an output error, with its relative degree; give it to `zero_dynamics` to study weights."""
    pair = Pair.of(model)
    expressions = error_expressions(pair, outputs)
    n = len(expressions)
    k = as_vector(slopes, n, "the slopes k_i of hierarchical surfaces", DesignError)
    w = np.asarray(weights, dtype=float).reshape(-1)
    if w.size != n or not np.all(np.isfinite(w)) or not np.any(w):
        raise DesignError(f"the weights are {w} for {n} outputs: give one number for each, not all zero.")
    if not np.all(k > 0):
        raise DesignError(f"the slopes k_i of hierarchical surfaces are {k}: give positive ones, in 1/s.")
    total = ca.SX(0)
    for (label, e), k_i, w_i in zip(expressions.items(), k, w, strict=True):
        if e.numel() != 1:
            raise DesignError(
                f"output '{label}' has {e.numel()} components: give scalar ones, each with its weight."
            )
        rate = pair.rate(e)
        if ca.depends_on(rate, pair.u):
            raise DesignError(
                f"a control enters the rate of output '{label}': it needs no surface of its own."
            )
        total += w_i * (k_i * e + rate)
    return chain_errors(pair, reference, {"S": total})
