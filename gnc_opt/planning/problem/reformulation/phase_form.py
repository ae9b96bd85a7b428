"""The form of a phase in other controls: all of it but the numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gnc_opt.model.model import Model
from gnc_opt.planning.problem.constraints import Constraint
from gnc_opt.planning.problem.phase import Phase
from gnc_opt.planning.problem.phase_data import PhaseNumbers, Restatement


def taken_names(model: Model) -> frozenset[str]:
    """Return the names of a model's variables and outputs."""
    layouts = (model.states, model.controls, model.parameters, model.outputs)
    return frozenset(name for layout in layouts for name in layout.names)


def free_name(model: Model, wanted: str) -> str:
    """Return a name that a model does not have yet."""
    taken = taken_names(model)
    while wanted in taken:
        wanted += "_"
    return wanted


def with_values_of(model: Model, old: Model) -> Model:
    """Return a model with the values of another one's parameters."""
    layout = old.parameters
    return model.with_parameters(
        **{v.name: old.parameter_values[layout.slice(v.name)] for v in layout.variables}
    )


@dataclass(frozen=True, eq=False)
class PhaseForm:
    """A phase reformulated in other controls."""

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
