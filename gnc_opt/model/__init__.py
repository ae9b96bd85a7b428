"""Symbolic model of a dynamic system: variables, parameters, dynamics and outputs."""

from gnc_opt.model.model_variables import Layout, Symbol, Variable
from gnc_opt.model.symbolic_dynamics_model import Model

__all__ = ["Layout", "Model", "Symbol", "Variable"]
