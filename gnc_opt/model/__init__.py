"""Model: variables, parameters, dynamics and outputs, written once and symbolically."""

from gnc_opt.model.layout import Layout, Variable
from gnc_opt.model.model import Model
from gnc_opt.model.symbol import Symbol

__all__ = ["Layout", "Model", "Symbol", "Variable"]
