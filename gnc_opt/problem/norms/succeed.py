"""What models that take the place of others need: names that are not taken, and the same numbers."""

from __future__ import annotations

from gnc_opt.model.model import Model


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
