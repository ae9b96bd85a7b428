r"""Reformulation of explicit norms and kinks as smooth terms.

``T.T @ T <= d**2``, ``norm_2(T) <= 5`` and ``sqrt(T_x**2 + T_y**2 + T_z**2)`` in a cost or a mass flow have no slope,
or no derivative, where a control is zero, which is where optima coast. With :math:`T = s n`, the magnitude s >= 0 and a
direction n within the unit ball or on its sphere (see ``Model.vector_control``), all is smooth: norms become s, limits
of norms limits of s, and cones about a direction, of which s is a factor, limits of n.

A convex kink of the cost (``fabs(u)``, ``fmax(2 * u, -u)``, ``if_else(u > 0, u / 0.8, 0.8 * u)``) with one corner along
one control makes this control a difference of two parts; for any other, a control above all of its pieces takes its
place (epigraph form). Limits of kinks are limits of their pieces. Everything else is solved as stated, and
`Problem.check` names it and the remedy. Bounds that leave an angle a whole turn limit nothing.
"""

from gnc_opt.planning.problem.reformulation.problem_reformulation import reformulate

__all__ = ["reformulate"]
