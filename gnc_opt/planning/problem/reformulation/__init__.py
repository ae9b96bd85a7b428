r"""Reformulation of explicit norms and kinks as smooth terms.

``T.T @ T <= d**2``, ``norm_2(T) <= 5`` and ``sqrt(T_x**2 + T_y**2 + T_z**2)`` in a cost or mass flow have a zero or
undefined derivative at zero control, as on coast arcs. With :math:`T = s n`, the magnitude s >= 0 and a direction n
in the unit ball or on its sphere (see ``Model.vector_control``), all functions are smooth: norms become s, limits of
norms become limits of s, and cones about a direction, with s as a factor, become limits of n.

A convex kink of the cost (``fabs(u)``, ``fmax(2 * u, -u)``, ``if_else(u > 0, u / 0.8, 0.8 * u)``) with one corner along
one control makes this control a difference of two parts. Any other convex kink is replaced by a control above all of
its pieces (epigraph form). A limit of a kink becomes a limit of each piece. Everything else is solved as stated, and
`Problem.check` reports it with a remedy. Bounds of an angle that allow a full turn are removed.
"""

from gnc_opt.planning.problem.reformulation.problem_reformulation import reformulate_problem

__all__ = ["reformulate_problem"]
