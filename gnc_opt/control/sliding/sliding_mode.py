r"""Sliding mode: surfaces from outputs of any relative degree, reaching laws, boundary layers.

For an output error e of relative degree r the surface and the law are

.. math:: s = \Big(\frac{d}{dt} + \lambda\Big)^{r-1} e = e^{(r-1)} + \dots + c_1 \dot e + c_0 e, \qquad
   u = E^{-1}\big( -a - c_{r-2} e^{(r-1)} - \dots - c_0 \dot e - \hat\Gamma - \rho(s) \big),

so that :math:`\dot s = -\rho(s) + d` with whatever the model leaves out, d. On s = 0 the error follows the poles of
the surface whatever d is, as long as it stays below the gain of the reaching law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.arguments import read_numbers
from gnc_opt.arrays import Array
from gnc_opt.control.controller import Controller
from gnc_opt.control.guard import GROWTH, GUARD
from gnc_opt.control.lie import OutputErrors, Outputs, given_for, output_errors
from gnc_opt.control.limits import Limits
from gnc_opt.control.poles import real_polynomial
from gnc_opt.control.reference import Reference, read_plant
from gnc_opt.control.sliding.reaching import Boundary, Law
from gnc_opt.control.sliding.super_twisting import SuperTwistingObserver
from gnc_opt.control.sliding.surface import surface_controller
from gnc_opt.control.sliding.switching import SlidingOptions
from gnc_opt.errors import DesignError, shown
from gnc_opt.model.model import Model
from gnc_opt.threads import one_thread

Slopes: TypeAlias = float | Sequence[Any] | Mapping[str, Any]
"""lambda (1/s) for all outputs, a sequence with one lambda per output component, or a mapping from outputs to lambda
or to the r - 1 poles of the surface."""


@one_thread()
def design_sliding_mode(
    model: Model,
    reference: Reference | ArrayLike,
    *,
    outputs: Outputs,
    slopes: Slopes = (),
    reaching: Law,
    boundary: Boundary,
    bound: ArrayLike = 0.0,
    observer: SuperTwistingObserver | None = None,
    limits: Limits | None = None,
    start: ArrayLike | None = None,
    dt: float | None = None,
    guard: float = GUARD,
    growth: float = GROWTH,
    name: str = "sliding mode",
) -> Controller:
    """Design a sliding-mode controller that follows the outputs of a reference.

    Parameters
    ----------
    model : Model
        Affine in its controls.
    reference : Reference or array (n_states,)
        Its control should keep it on the model's dynamics: it is the feedforward.
    outputs : name, names, expressions or mapping
        See `Outputs`; at most as many components as controls.
    slopes : float, sequence or mapping
        See `Slopes`; not needed for outputs of relative degree 1.
    reaching : ConstantRate, ExponentialRate, PowerRate or SuperTwisting
    boundary : Sign, SaturationLayer or TanhLayer
    bound : float or array (n_outputs,)
        Largest disturbance of the r-th derivatives of the outputs; for `SuperTwisting` its largest rate.
    observer : SuperTwistingObserver, optional
        Estimates the disturbance, which the law then cancels; the reaching law has to cover only what is left.
    limits : (lower, upper), optional
        Authority, each a number or (n_controls,): checked along the reference, and the observer takes the
        limited command for the one in force. The law itself does not limit its command.
    start : array (n_states,), optional
        State from which the closed loop is rehearsed, its commands cut to ``limits``: a start from which it runs away
        or does not come back is refused, and the reaching time in `Controller.explain` is that of the limited command.
    dt : float, optional
        Length of a control step, s; needed by laws with memory.
    guard : float
        Smallest determinant of the decoupling matrix, relative to its largest on the reference.
    growth : float
        Fastest growth of the zero dynamics that is accepted, 1/s; raise it for slow drifts that a mission survives.
    name : str
        For messages and reports.

    Returns
    -------
    Controller

    Raises
    ------
    DesignError
        Undefined relative degree, singular decoupling matrix, disturbances above the gain, gain above the
        authority, steps too long for the boundary layer or the slopes, unstable surface or zero dynamics, a start from
        which the limited loop does not come back.

    Examples
    --------
    >>> from gnc_opt.control import ConstantRate, SaturationLayer
    >>> law = go.design_sliding_mode(
    ...     *(cart, [0.0, 0.0]), outputs="q", slopes=2.0, bound=0.2,
    ...     reaching=ConstantRate(0.5), boundary=SaturationLayer(0.1),
    ... )
    >>> u, _ = law(0.0, [1.0, 0.0], dt=0.01)
    >>> print(u)  # far from the surface: the full rate
    [-0.5]
    """
    reference = read_plant(model, reference, "design_sliding_mode")
    errors = output_errors(model, reference, outputs)
    coefficients = _coefficients(errors, slopes)
    title = f"sliding mode of '{model.name}' on {', '.join(errors.labels)}"
    options = SlidingOptions(
        reaching, boundary, bound, observer, limits, start, dt, guard=guard, growth=growth
    )
    return surface_controller(name, title, errors, reference, coefficients, options)


def _coefficients(errors: OutputErrors, slopes: Slopes) -> list[Array]:
    """Return c_0, ..., c_{r-2}, 1 of each surface."""
    found = []
    for i, (label, r) in enumerate(zip(errors.labels, errors.degrees, strict=True)):
        given = _slope_of(errors, slopes, label, i) if r > 1 else []
        try:
            poles = np.asarray(given, dtype=complex)
        except (TypeError, ValueError):
            raise DesignError(
                f"the slope of output '{label}' is {shown(given)}: give lambda, in 1/s, or poles."
            ) from None
        if poles.ndim == 0:
            poles = np.full(r - 1, -poles)
        if poles.shape != (r - 1,):
            raise DesignError(
                f"output '{label}' has relative degree {r}: give lambda, or {r - 1} pole{'s' * (r > 2)}, "
                f"not {poles.size}."
            )
        polynomial = real_polynomial(poles)
        if polynomial is None or not np.all(poles.real < 0):
            raise DesignError(
                f"the surface of output '{label}' has the poles {poles}: give lambda > 0, or poles with negative "
                "real parts in conjugate pairs."
            )
        found.append(polynomial[::-1])
    return found


def _slope_of(errors: OutputErrors, slopes: Slopes, label: str, index: int) -> Any:
    if isinstance(slopes, Mapping):
        slope = given_for(label, slopes, errors, "the surface")
        if slope is None:
            raise DesignError(f"output '{label}' has relative degree > 1: give its slope lambda, in 1/s.")
        return slope
    if isinstance(slopes, Sequence):
        if len(slopes) != errors.size:
            raise DesignError(
                f"{len(slopes)} slopes are given for {errors.size} surfaces ({', '.join(errors.labels)}): give lambda, "
                "in 1/s, for all or one for each."
            )
        return slopes[index]
    return float(read_numbers(slopes, "lambda, the slope of a surface", DesignError).reshape(()))
