"""Symbolic model of a dynamic system: variables, parameters, dynamics and outputs."""

from gnc_opt.model.model import Model
from gnc_opt.model.model_variables import Layout, Symbol, Variable

__all__ = ["Layout", "Model", "Symbol", "Variable"]
