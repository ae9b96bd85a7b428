r"""Error space of a quantity: its values, and the coordinates of its errors.

An error e of x relative to :math:`x_r` is :math:`d(x, x_r)`, with the inverse :math:`x = r(x_r, e)`. To first order
:math:`dx = R\, e` and :math:`e = D\, dx` with

.. math:: R = \left.\frac{\partial r}{\partial e}\right|_{e=0}, \qquad
   D = \left.\frac{\partial d}{\partial x}\right|_{x=x_r}, \qquad D R = 1 .

Covariances are those of e. For attitudes this gives the multiplicative filter (Markley and Crassidis, Fundamentals of
Spacecraft Attitude Determination and Control, 2014, section 6.2.4) for any attitude parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class Space:
    """Space of column vectors (size, 1) with errors (errors, 1).

    Attributes
    ----------
    difference : callable
        ``difference(x, x_ref) -> e`` of SX columns.
    retraction : callable
        ``retraction(x_ref, e) -> x``.
    """

    size: int
    errors: int
    difference: Callable[[Any, Any], Any]
    retraction: Callable[[Any, Any], Any]

    def build_state_difference_jacobian(self, x: Any) -> Any:
        """Return D (errors, size) at an SX column x."""
        state, reference = ca.SX.sym("x", self.size), ca.SX.sym("x_ref", self.size)
        slope = ca.jacobian(self.difference(state, reference), state)
        return ca.substitute(slope, ca.vertcat(state, reference), ca.vertcat(x, x))

    def build_state_retraction_jacobian(self, x: Any) -> Any:
        """Return R (size, errors) at an SX column x."""
        state, error = ca.SX.sym("x", self.size), ca.SX.sym("e", self.errors)
        slope = ca.jacobian(self.retraction(state, error), error)
        return ca.substitute(slope, ca.vertcat(state, error), ca.vertcat(x, ca.SX.zeros(self.errors)))


def build_euclidean_error_coordinates(size: int) -> Space:
    return Space(size, size, lambda x, ref: x - ref, lambda ref, e: ref + e)


def build_stacked_error_coordinates(spaces: Sequence[Space]) -> Space:
    sizes = [0, *_compute_cumulative_sums(s.size for s in spaces)]
    errors = [0, *_compute_cumulative_sums(s.errors for s in spaces)]

    def compute_stacked_state_difference(x: Any, ref: Any) -> Any:
        parts = zip(spaces, ca.vertsplit(x, sizes), ca.vertsplit(ref, sizes), strict=True)
        return ca.vertcat(*[s.difference(own, other) for s, own, other in parts])

    def retract_stacked_states(ref: Any, e: Any) -> Any:
        parts = zip(spaces, ca.vertsplit(ref, sizes), ca.vertsplit(e, errors), strict=True)
        return ca.vertcat(*[s.retraction(own, error) for s, own, error in parts])

    return Space(sizes[-1], errors[-1], compute_stacked_state_difference, retract_stacked_states)


def _compute_cumulative_sums(numbers: Any) -> list[int]:
    total, sums = 0, []
    for number in numbers:
        total += number
        sums.append(total)
    return sums
