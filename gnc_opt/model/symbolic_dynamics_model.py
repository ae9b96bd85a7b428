"""Model: symbolic dynamics of a vehicle."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import (
    StrictAttributes,
    read_float_array,
    read_integer,
    read_variable_name,
    require_type,
)
from gnc_opt.array_types import Array
from gnc_opt.errors import ModelError, quote_value, suggest_model_symbol
from gnc_opt.model.casadi_function_evaluation import evaluate_casadi_function, read_casadi_function_arguments
from gnc_opt.model.lookup_table import TableCall
from gnc_opt.model.model_from_casadi import (
    read_parameter_values,
    read_state_derivative,
    read_variable_declarations,
)
from gnc_opt.model.model_variables import (
    Layout,
    Symbol,
    Variable,
    VariableSet,
    VectorSymbols,
    convert_to_sx_column,
    find_unknown_symbols,
    read_vector,
)
from gnc_opt.model.split_and_magnitude_direction_controls import ComposedControl, SplitControl, VectorControl
from gnc_opt.model.state_differences import StateDifferences
from gnc_opt.text_html_and_json_formatting import pluralise_noun

_ARGUMENTS = ["t", "x", "u", "p"]


class Model(StrictAttributes):
    """Dynamics ``dx/dt = f(t, x, u, p)`` with named, vector-valued variables.

    Parameters
    ----------
    name : str
        Name in messages and reports.

    Examples
    --------
    >>> cart = Model("double integrator")
    >>> q = cart.state("q", unit="m")
    >>> v = cart.state("v", unit="m/s")
    >>> a = cart.control("a", unit="m/s^2")
    >>> cart.ode({q: v, v: a})
    """

    __slots__ = (
        "_algebraic",
        "_composed_controls",
        "_differences",
        "_equations",
        "_functions",
        "_in_use_by",
        "_outputs",
        "_parameter_values",
        "_time",
        "_variables",
        "name",
    )

    def __init__(self, name: str) -> None:
        self.name: str = require_type(name, str, "the name of a model", 'write Model("cart")')
        self._variables = VariableSet(f"model '{self.name}'")
        self._parameter_values: dict[str, Array] = {}
        self._equations: dict[str, Any] = {}
        self._outputs: dict[str, tuple[Variable, Any]] = {}
        self._differences = StateDifferences(f"model '{self.name}'")
        self._time = Symbol(Variable("t", unit="s"))
        self._in_use_by: str | None = None
        self._composed_controls: dict[str, ComposedControl] = {}
        self._algebraic: dict[str, Any] = {}
        self._functions: dict[str, Any] = {}

    @classmethod
    def from_casadi(
        cls,
        name: str,
        x: Any,
        u: Any,
        f: Any,
        *,
        t: Any = None,
        p: Any = (),
        values: Mapping[str, ArrayLike] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Model:
        """Return a model of dynamics that are written in CasADi.

        Parameters
        ----------
        name : str
        x, u, p : symbols
            Columns of SX or MX symbols, or mappings from names to columns or, if ``f`` is a Function, to sizes.
        f : casadi.SX, casadi.MX, list of these or casadi.Function
            dx/dt (n_states, 1), or a function of some of t, x, u, p by name.
        t : casadi symbol, optional
            Symbol of time, s.
        values : mapping, optional
            Value of each parameter by name.
        units : mapping, optional
            Units by name.

        Raises
        ------
        ModelError
            ``f`` uses other symbols or has a wrong size, or a parameter has no value.

        Examples
        --------
        >>> import casadi as ca
        >>> q, v, a = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("a")
        >>> cart = Model.from_casadi("cart", [q, v], a, ca.vertcat(v, a), units={"q": "m"})
        >>> cart.f(0.0, [0.0, 2.0], 3.0)
        array([2., 3.])
        """
        model = cls(name)
        states, controls, parameters = (
            read_variable_declarations(given, f"the {what} of model '{name}'")
            for what, given in (("states", x), ("controls", u), ("parameters", p))
        )
        names = [v.name for v in (*states, *controls, *parameters)]
        units = read_parameter_values(units, names, f"units= of '{name}'")
        values = read_parameter_values(values, [v.name for v in parameters], f"values= of '{name}'")
        for v in states:
            model.state(v.name, v.size, unit=units.get(v.name, ""))
        for v in controls:
            model.control(v.name, v.size, unit=units.get(v.name, ""))
        for v in parameters:
            if v.name not in values:
                raise ModelError(f"parameter '{v.name}' has no value: add it to values=.")
            value = read_vector(values[v.name], v.size, f"parameter '{v.name}'", ModelError)
            model.parameter(v.name, value, unit=units.get(v.name, ""))
        symbols = {
            letter: [v.symbol for v in group]
            for letter, group in zip("xup", (states, controls, parameters), strict=True)
        }
        symbols = {"t": [] if t is None else [t], **symbols}
        arguments = dict(zip(_ARGUMENTS, model.symbolic_arguments(), strict=True))
        rate = read_state_derivative(f, arguments, symbols, model.states.size, f"dx/dt of model '{name}'")
        model.ode({state: rate[model.states.slice(state)] for state in model.states.names})
        return model

    def __repr__(self) -> str:
        return (
            f"Model({self.name!r}: {pluralise_noun(self.states.size, 'state')}, "
            f"{pluralise_noun(self.controls.size, 'control')}, {pluralise_noun(self.parameters.size, 'parameter')})"
        )

    # --- declarations -----------------------------------------------------------------------------

    def state(self, name: str, size: int = 1, *, unit: str = "", nominal: ArrayLike | None = None) -> Symbol:
        """Declare a state of ``size`` components and return its symbol.

        Parameters
        ----------
        name : str
            A Python identifier, unique in the model.
        size : int
            Number of components.
        unit : str
            For printing, e.g. ``"m/s"``.
        nominal : array-like, optional
            Typical magnitude, scalar or one per component, > 0; overrides the automatic scaling.

        Raises
        ------
        ModelError
            Name already declared or not an identifier, size < 1, nominal not positive, model already in use.
        """
        return self._declare_model_variable("state", name, size, unit, nominal)

    def control(
        self, name: str, size: int = 1, *, unit: str = "", nominal: ArrayLike | None = None
    ) -> Symbol:
        """Declare a control; arguments and errors as in `state`."""
        return self._declare_model_variable("control", name, size, unit, nominal)

    def split_control(
        self, name: str, size: int = 1, *, unit: str = "", nominal: ArrayLike | None = None
    ) -> tuple[Any, Any]:
        """Declare a control whose absolute value is part of the cost, as the difference of two controls >= 0.

        The controls ``name_plus`` and ``name_minus`` are >= 0; at an optimum at most one of them is nonzero.
        ``Phase.bounds``, ``Phase.guess`` and solutions accept ``name``, which is also an output.

        Parameters
        ----------
        name, size, unit, nominal
            As in `state`.

        Returns
        -------
        tuple of casadi.SX
            The control and its componentwise absolute value, (size, 1) each.
        """
        plus = self.control(f"{name}_plus", size, unit=unit, nominal=nominal)
        minus = self.control(f"{name}_minus", size, unit=unit, nominal=nominal)
        return self._declare_composed_control(SplitControl, name, plus, minus, unit), plus + minus

    def vector_control(
        self, name: str, size: int, *, unit: str = "", nominal: ArrayLike | None = None
    ) -> tuple[Any, Any]:
        """Declare a control whose Euclidean norm is limited or part of the cost, without a kink at zero.

        The controls are ``name_magnitude``, >= 0, and ``name_direction``. The direction is in the unit ball, or on the
        unit sphere if the norm has a lower limit > 0 or an expression is not affine in the direction.
        ``Phase.norm_bounds`` limits the norm.

        Within the ball the norm is at most the magnitude. In affine problems both are equal at an optimum
        (Acikmese and Ploen, J. Guidance 30 (2007) 1353).

        Parameters
        ----------
        name : str
        size : int
            At least 2; for one component use ``split_control``.
        unit, nominal
            As in `state`; ``nominal`` is the typical norm.

        Returns
        -------
        tuple of casadi.SX
            The control (size, 1), and its magnitude for costs and mass flow rates.
        """
        read_integer(size, f"the size of vector control '{name}' of model '{self.name}'", 2, ModelError)
        magnitude = self.control(f"{name}_magnitude", unit=unit, nominal=nominal)
        direction = self.control(f"{name}_direction", size, nominal=1.0)
        return VectorSymbols(
            (self._declare_composed_control(VectorControl, name, magnitude, direction, unit), magnitude)
        )

    def algebraic(
        self,
        name: str,
        residual: Callable[[Any], Any],
        size: int = 1,
        *,
        unit: str = "",
        nominal: ArrayLike | None = None,
    ) -> Symbol:
        """Declare an algebraic variable z of a semi-explicit system of index 1: g(t, x, u, p, z) = 0 along a phase.

        Each phase has z as a control and the path constraint ``equation of z``. If g = 0 has several solutions, the
        guess selects one.

        Parameters
        ----------
        name, size, unit, nominal
            As in `state`.
        residual : callable
            ``residual(z)`` returns g (as many rows as z) in the symbols declared so far.

        Raises
        ------
        ModelError
            As in `state`; or g has a wrong size or a Jacobian in z that is singular for all values.

        Examples
        --------
        >>> model = go.Model("pendulum in its plane")
        >>> y = model.state("y", unit="m")
        >>> x = model.algebraic("x", lambda x: x**2 + y**2 - 1.0, unit="m")
        """
        symbol = self.control(name, size, unit=unit, nominal=nominal)
        what = f"the equation of algebraic variable '{name}' of model '{self.name}'"
        if not callable(residual):
            raise ModelError(
                f"{what} is {quote_value(residual)}: give a function of the variable, lambda z: ..."
            )
        value = self._read_model_expression(residual(symbol), what, symbol.variable.size)
        if ca.sprank(ca.jacobian(value, symbol)) < symbol.variable.size:
            raise ModelError(
                f"{what} does not determine it (index higher than 1): use '{name}' in every row, or "
                "differentiate the equation."
            )
        self._algebraic[name] = value
        return symbol

    def parameter(self, name: str, value: ArrayLike, *, unit: str = "") -> Symbol:
        """Declare a constant parameter with its value (scalar or vector); `with_parameters` changes it.

        ``Problem.parameter`` of the same name makes it an optimisation variable.
        """
        vector = self._read_finite_parameter_values(name, value, None)
        symbol = self._declare_model_variable("parameter", name, vector.size, unit, None)
        self._parameter_values[name] = vector
        return symbol

    def ode(self, equations: Mapping[Symbol | str, Any]) -> None:
        """Define the dynamics: a mapping from state (symbol or name) to its time derivative.

        Raises
        ------
        ModelError
            A state has two equations or one of wrong size, or an expression uses a symbol of another model.
        """
        self._require_unused_model("ode")
        remedy = "write ode({q: v, v: a}), each state with its time derivative"
        for key, value in require_type(
            equations, Mapping, f"the argument of ode() of model '{self.name}'", remedy
        ).items():
            name = self._variables.read_state_name(key)
            if name in self._equations:
                raise ModelError(
                    f"model '{self.name}' defines the dynamics of state '{name}' twice: keep one."
                )
            size = self.states[name].size
            what = f"the time derivative of state '{name}' in model '{self.name}'"
            self._equations[name] = self._read_model_expression(value, what, size)

    def output(self, name: str, expression: Any, *, unit: str = "") -> Any:
        """Declare an algebraic output y(t, x, u, p), evaluated later by name; returns the expression."""
        self._require_unused_model("output")
        self._require_new_variable_name(name)
        value = self._read_model_expression(expression, f"output '{name}' of model '{self.name}'", None)
        self._outputs[name] = (Variable(name, value.shape[0], unit), value)
        return value

    def difference(
        self,
        state: Symbol | str,
        function: Callable[[Any, Any], Any],
        retraction: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        """Declare the error of a state relative to a reference, if it is not a plain difference (attitudes).

        Parameters
        ----------
        state : Symbol or str
        function : callable
            ``function(x, x_ref)`` of SX columns returns the error, to first order; 3 components for a quaternion. The
            error has the unit of the state, or rad with the functions of `gnc_opt.spacecraft`.
        retraction : callable, optional
            ``retraction(x_ref, e)`` returns the state with error e relative to x_ref; needed by estimators.

        Raises
        ------
        ModelError
            The result is not an SX column, uses other symbols, or the retraction has another size.
        """
        self._require_unused_model("difference")
        name = self._variables.read_state_name(state)
        self._differences.set_state_error_function(name, function, retraction)
        self.state_error_expression(self.symbols("state"), ca.SX.sym("x_ref", self.states.size))
        if retraction is not None:
            own = self.symbols("state")[self.states.slice(name)]
            self._differences.retract_state(name, own, ca.SX.sym("e", self.errors[name].size))

    def with_parameters(self, **values: ArrayLike) -> Model:
        """Return a copy of the model with other parameter values (same symbols, same equations)."""
        changed = copy.copy(self)
        changed._parameter_values = dict(self._parameter_values)
        for name, value in values.items():
            changed._parameter_values[name] = self._read_finite_parameter_values(
                name, value, self.parameters[name].size
            )
        return changed

    def express_in_other_controls(
        self,
        controls: Sequence[Symbol],
        composed: Sequence[tuple[ComposedControl, Any]],
        express: Callable[[Any], Any],
    ) -> Model:
        """Return the same dynamics with other controls.

        ``composed`` expresses the replaced controls by the new ``controls``; ``express`` rewrites an expression.
        """
        twin = copy.copy(self)
        twin._functions = {}
        twin._variables = self._variables.replace_control_variables(controls)
        twin._equations = {name: express(rate) for name, rate in self._equations.items()}
        twin._outputs = {name: (v, express(y)) for name, (v, y) in self._outputs.items()}
        twin._outputs |= {c.name: (c.variable, value) for c, value in composed}
        twin._composed_controls = {**self._composed_controls, **{c.name: c for c, _ in composed}}
        return twin

    def with_states(self, rates: Mapping[Symbol, Any], controls: Sequence[Symbol] = ()) -> Model:
        """Return the model with additional states, their rates, and additional controls.

        Controls of this model can become states; they keep their symbols.
        """
        twin = copy.copy(self)
        twin._functions = {}
        twin._variables = self._variables.add_states_and_controls(list(rates), controls)
        twin._equations = {
            **self._equations,
            **{s.variable.name: convert_to_sx_column(r, "") for s, r in rates.items()},
        }
        return twin

    @property
    def time(self) -> Any:
        """Symbol of time t (s), for time-dependent dynamics."""
        return self._time

    @property
    def states(self) -> Layout:
        """Names, sizes and units of the states."""
        return self._variables.layout("state")

    @property
    def controls(self) -> Layout:
        """Names, sizes and units of the controls."""
        return self._variables.layout("control")

    @property
    def parameters(self) -> Layout:
        """Names, sizes and units of the parameters."""
        return self._variables.layout("parameter")

    @property
    def outputs(self) -> Layout:
        """Names, sizes and units of the outputs."""
        return Layout("output", tuple(v for v, _ in self._outputs.values()), f"model '{self.name}'")

    @property
    def composed_controls(self) -> Mapping[str, ComposedControl]:
        """Controls declared by `split_control` and `vector_control`, by name."""
        return self._composed_controls

    @property
    def algebraic_equations(self) -> Mapping[str, Any]:
        """Expressions that are zero along every trajectory, by the name of their algebraic variable."""
        return self._algebraic

    @property
    def parameter_values(self) -> Array:
        """Stacked parameter values, shape (n_parameters,)."""
        return self.parameters.stack(self._parameter_values)

    @property
    def errors(self) -> Layout:
        """Names, sizes and units of the errors of the states; see `difference`."""
        return self._differences.build_state_error_layout(
            self.states, self.symbols("state"), ca.SX.sym("x_ref", self.states.size)
        )

    def state_error_expression(self, x: Any, x_ref: Any) -> Any:
        """Return the stacked SX errors of states x relative to x_ref, both SX (n_states, 1)."""
        return ca.vertcat(*self._differences.iterate_state_error_expressions(self.states, x, x_ref))

    def retraction_expression(self, x_ref: Any, e: Any) -> Any:
        """Return the stacked SX states with errors e (n_errors, 1) relative to x_ref (n_states, 1), both SX.

        Raises
        ------
        ModelError
            A state has a difference without a retraction.
        """
        states, errors, moved = self.states, self.errors, self._differences.retract_state
        return ca.vertcat(*[moved(n, x_ref[states.slice(n)], e[errors.slice(n)]) for n in states.names])

    def symbols(self, kind: str) -> Any:
        """Return the stacked SX vector of "state", "control" or "parameter" symbols."""
        return self._variables.stack_symbols(kind)

    def symbol(self, name: str) -> Symbol:
        """Return the symbol of a declared state, control or parameter."""
        return self._variables.get_symbol(name)

    def state_derivative(self) -> Any:
        """Return the SX expression of dx/dt, stacked over the states; raise `ModelError` if an equation is missing."""
        missing = [name for name in self.states.names if name not in self._equations]
        if missing:
            raise ModelError(
                f"model '{self.name}' has no dynamics for state{'s' * (len(missing) > 1)} "
                f"{', '.join(repr(m) for m in missing)}: add {'them' if len(missing) > 1 else 'it'} to ode()."
            )
        if not self._equations:
            raise ModelError(
                f"model '{self.name}' has no states: declare them with state() and define their ode()."
            )
        return ca.vertcat(*[self._equations[name] for name in self.states.names])

    def find_lookup_table_calls(self) -> list[TableCall]:
        """Return the table calls with expressions of the model's symbols."""
        return [use for symbol in (self._time, *self._variables.symbols) for use in symbol.table_calls]

    def output_expression(self, name: str) -> Any:
        """Return the SX expression of a declared output."""
        self.outputs.slice(name)
        return self._outputs[name][1]

    def symbolic_arguments(self) -> tuple[Any, Any, Any, Any]:
        """Return the symbols (t, x, u, p), the arguments of every function of a model."""
        return self._time, self.symbols("state"), self.symbols("control"), self.symbols("parameter")

    # --- numeric calls ----------------------------------------------------------------------------

    @property
    def function(self) -> Any:
        """CasADi Function ``f(t, x, u, p) -> dx/dt``."""
        return self._build_cached_model_function("f", lambda: [self.state_derivative()], "dx_dt")

    def to_function(self) -> Any:
        """Return the CasADi Function ``(t, x, u, p) -> (dx_dt, y)``, y the stacked outputs, for other tools.

        `from_casadi` accepts it with the names and sizes of `states`, `controls`, `parameters` and `outputs`.
        """
        outputs = [self.output_expression(name) for name in self.outputs.names]
        stacked = ca.vertcat(*outputs) if outputs else ca.SX(0, 1)
        return self._build_cached_model_function(
            "model", lambda: [self.state_derivative(), stacked], "dx_dt", "y"
        )

    def f(self, t: ArrayLike, x: ArrayLike, u: ArrayLike, p: ArrayLike | None = None) -> Array:
        """Evaluate dx/dt.

        Parameters
        ----------
        t : float or array (n_times,)
        x : array (n_states,) or (n_states, n_times)
        u : array (n_controls,) or (n_controls, n_times)
        p : array (n_parameters,), optional
            Default: the model's own values.

        Returns
        -------
        array
            Shape of ``x``.
        """
        return evaluate_casadi_function(self.function, t, x, u, self.parameter_values if p is None else p)

    def linearize(
        self, t: float, x: ArrayLike, u: ArrayLike, p: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return A = df/dx (n, n) and B = df/du (n, m) at one point."""
        _, xs, us, _ = self.symbolic_arguments()
        jacobians = self._build_cached_model_function(
            "AB",
            lambda: [ca.jacobian(self.state_derivative(), xs), ca.jacobian(self.state_derivative(), us)],
            "A",
            "B",
        )
        a, b = jacobians(
            *read_casadi_function_arguments(jacobians, t, x, u, self.parameter_values if p is None else p)
        )
        return np.asarray(a.full()), np.asarray(b.full())

    def forbid_further_declarations(self, user: str) -> None:
        """Forbid further declarations, because a problem uses the model."""
        self._in_use_by = self._in_use_by or user

    def _build_cached_model_function(self, name: str, expressions: Any, *names: str) -> Any:
        if name not in self._functions:
            self._functions[name] = ca.Function(
                name, list(self.symbolic_arguments()), expressions(), _ARGUMENTS, list(names)
            )
        return self._functions[name]

    def _declare_model_variable(
        self, kind: str, name: str, size: int, unit: str, nominal: ArrayLike | None
    ) -> Symbol:
        self._require_unused_model(kind)
        self._require_new_variable_name(name)
        return self._variables.declare_variable(kind, name, size, unit, nominal)

    def _declare_composed_control(
        self, kind: type[ComposedControl], name: str, first: Symbol, second: Symbol, unit: str
    ) -> Any:
        size = max(first.variable.size, second.variable.size)
        parts = (first.variable.name, second.variable.name)
        composed = kind(Variable(name, size, unit), parts)
        value = self.output(name, composed.compose_control(first, second), unit=unit)
        self._composed_controls[name] = composed
        return value

    def _require_new_variable_name(self, name: str) -> None:
        read_variable_name(name, f"variable of model '{self.name}'", ModelError)
        if name in self._variables.names or name in self._outputs:
            raise ModelError(f"model '{self.name}' declares '{name}' twice: rename one of the two.")

    def _require_unused_model(self, what: str) -> None:
        if self._in_use_by is not None:
            raise ModelError(
                f"model '{self.name}' is already used by {self._in_use_by}: "
                f"call {what}() before the model is given to a problem."
            )

    def _read_finite_parameter_values(self, name: str, value: ArrayLike, size: int | None) -> Array:
        what = f"parameter '{name}' of model '{self.name}'"
        given = read_float_array(value, what, ModelError).size if size is None else size
        vector = read_vector(value, given, what, ModelError)
        if vector.size == 0 or not np.all(np.isfinite(vector)):
            raise ModelError(f"{what} is {vector}: give finite numbers.")
        return vector

    def _read_model_expression(self, value: Any, what: str, size: int | None) -> Any:
        expression = convert_to_sx_column(value, what, size)
        foreign = find_unknown_symbols(expression, list(self.symbolic_arguments()))
        if foreign:
            raise ModelError(
                f"{what} uses '{foreign[0]}', which is not a symbol of this model: "
                f"{suggest_model_symbol(foreign[0], self._variables.names)}"
            )
        return expression
