"""The form of a phase in other controls: all of it but the numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gnc_opt.model.model import Model
from gnc_opt.problem.constraint import Constraint
from gnc_opt.problem.norms.succeed import with_values_of
from gnc_opt.problem.phase import Phase
from gnc_opt.problem.phase_numbers import PhaseNumbers
from gnc_opt.problem.restatement import Restatement


@dataclass(frozen=True, eq=False)
class PhaseForm:
    """A phase restated in other controls.

    Attributes
    ----------
    model : Model
    paths : dict of Constraint
    integrands : dict of (symbol, expression)
    restatement : Restatement
    """

    model: Model
    paths: dict[str, Constraint]
    integrands: dict[str, tuple[Any, Any]]
    restatement: Restatement

    def give(self, leg: Phase, numbers: PhaseNumbers) -> None:
        """Give a phase this form, and numbers in its controls."""
        leg.model = with_values_of(self.model, leg.model)
        leg.numbers = numbers
        leg.paths, leg.integrands = dict(self.paths), dict(self.integrands)
        leg.restatement = self.restatement.after(leg.restatement)
