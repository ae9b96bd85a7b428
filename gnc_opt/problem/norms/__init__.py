r"""Norms of controls written by hand, restated as magnitudes of vector controls.

``T.T @ T <= d**2``, ``norm_2(T) <= 5`` and ``sqrt(T_x**2 + T_y**2 + T_z**2)`` in a cost or a mass flow have no slope,
or no derivative, where a control is zero, which is where optima coast. With :math:`T = s n`, the magnitude s >= 0 and a
direction n within the unit ball or on its sphere (see ``Model.vector_control``), all is smooth: norms become s, limits
of norms limits of s, and cones about a direction, of which s is a factor, limits of n.
"""

from gnc_opt.problem.norms.restate import restated

__all__ = ["restated"]
