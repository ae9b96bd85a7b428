"""What a problem file knows about the right answer: a reference value, and where there is one a closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """The known optimal value of a problem at the default arguments of its ``build``.

    Attributes
    ----------
    value : float
        Of the objective as stated, also when it is maximised.
    source : str
        A closed form, a publication, or how an independent calculation was made.
    tolerance : float
        How closely a correct solution must agree, absolute, in the objective's unit.
    unit : str
        Of the objective; empty if it has none.
    """

    value: float
    source: str
    tolerance: float
    unit: str = ""

    def difference(self, objective: float) -> float:
        """Return how far an objective is off, with its sign."""
        return float(objective - self.value)

    def agrees(self, objective: float) -> bool:
        """Whether an objective is the reference's within the tolerance; a NaN never is."""
        return bool(abs(self.difference(objective)) <= self.tolerance)


@dataclass(frozen=True)
class Extremal:
    """States, controls and costates of the optimum at given times, by name; what is not known is left out.

    Costates have the library's signs: the Hamiltonian is minimised, ``lam(t_0)`` is the derivative of the
    minimised cost with respect to the initial state.
    """

    states: Mapping[str, Array] = field(default_factory=dict)
    controls: Mapping[str, Array] = field(default_factory=dict)
    costates: Mapping[str, Array] = field(default_factory=dict)
