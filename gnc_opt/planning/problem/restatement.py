"""Map from the stated controls of a phase to the controls in which it is solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from gnc_opt.model.model import Model


@dataclass(frozen=True, eq=False)
class Restatement:
    """Explicit control norms reformulated as magnitudes of vector controls.

    Attributes
    ----------
    model : Model
        As it was stated.
    stated : casadi.SX
        The controls that were stated and are no more, stacked, (k, 1).
    solved : casadi.SX
        What they are in the controls that are solved for, (k, 1).
    values : casadi.SX
        The controls that are solved for, in order, in those that were stated, (m, 1); NaN where any would do.
    texts : tuple of str
        What was restated, a clause per norm.
    filled_in_order : tuple of str
        Split controls of which rates are those that were stated only if no part is used before those nearer to the
        first corner are full.
    """

    model: Model
    stated: Any
    solved: Any
    values: Any
    texts: tuple[str, ...]
    filled_in_order: tuple[str, ...] = ()

    @classmethod
    def of_limits(cls, model: Model, texts: tuple[str, ...]) -> Restatement:
        """Return one that leaves the controls as they are."""
        none = ca.SX(0, 1)
        return cls(model, none, none, model.symbols("control"), texts)

    def of(self, expression: Any) -> Any:
        """Return an expression of the stated controls in the solved ones."""
        return ca.substitute(expression, self.stated, self.solved)

    def after(self, earlier: Restatement | None) -> Restatement:
        """Return this one and an earlier one, of whose controls it restates some, as one."""
        if earlier is None:
            return self
        return Restatement(
            earlier.model,
            ca.vertcat(earlier.stated, self.stated),
            ca.vertcat(self.of(earlier.solved), self.solved),
            ca.substitute(self.values, self.model.symbols("control"), earlier.values),
            (*earlier.texts, *self.texts),
            (*earlier.filled_in_order, *self.filled_in_order),
        )
