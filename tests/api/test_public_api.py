"""Every public name is a decision, is documented and typed, and is cheap to import.

The rule: every public name has a docstring. Functions and constructors describe each parameter by name in numpydoc
sections, no more and no fewer than they have, and functions say what they return, there or in their first line ("Return
..."). Methods may do with prose: their own docstring, or that of their class for what all methods share, names every
parameter but two at most (which name and type explain), or points to a method that does ("as in `state`").
"""

import enum
import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import pytest

import gnc_opt

EXPECTED = {
    "gnc_opt": """
        Arc ArcKind ArgumentError Campaign ClosedLoop Condition Continuation ContinuationStatus Controller
        DesignError Scenario DesignReport GncOptError History LinearCovariance LowerBound Mesh Minimum Model ModelError
        Multistart Outcome Phase
        PhaseSolution Problem ProblemError ProblemWarning Reference RefinementLimits RefinementStatus Resolver
        ConditionResult Run RunStatus
        Sensitivity Solution SolveError SolverOptions Status Sweep Table UnknownAttributeError
        UnknownNameError Verdict lower_bound bryson continuation design_ekf design_feedback_linearization
        design_integral_sliding_mode design_lqr design_mpc
        design_neighbouring_optimal
        design_sliding_mode design_tvlqr design_ukf export_c export_fmu feedforward guess_from_data guess_from_solution
        linear_covariance load
        monte_carlo multistart output_feedback refine sensitivity guess_from_simulation
        smooth_abs solve sweep
        table table_from_csv verify verify_trajectory
    """,
    "gnc_opt.control": """
        ConstantRate Controller ErrorDynamics DesignReport ExponentialRate ReportEntry CCode
        Fmu Reference SaturationLayer Sign SuperTwisting
        SuperTwistingObserver with_dropout_handling bryson
        design_feedback_linearization design_integral_sliding_mode
        design_lqr design_mpc design_sliding_mode design_tvlqr export_c
        export_fmu feedforward initial_state_function law_function lie_derivative output_errors trim
        zero_dynamics
    """,
    "gnc_opt.estimation": """
        Estimator FilterOptions Measurement design_ekf
        design_ukf output_feedback
    """,
    "gnc_opt.guidance": """
        Replanner design_neighbouring_optimal
    """,
    "gnc_opt.simulation": """
        Allocation UniformInBall Bias Block Campaign Choice ClosedLoop ConstantDisturbance Deadband Delay Disturbance
        FinalValues Envelope Event ExpressionDisturbance CompiledLoop ZeroOrderHold Lag Mixer Noise
        Normal EventOccurrence SensorOutage Outcome Pwm Pwpf Quantisation
        Quantity PiecewiseConstantNoise RandomWalk RateLimit Replan Run RunStatus Saturation
        ScaleFactor SchmittTrigger SinusoidalDisturbance RandomDirection thruster_effects
        RandomRotation Uniform WheelArray
        monte_carlo
    """,
    "gnc_opt.analysis": """
        Consistency Scenario InnovationTest
        LinearCovariance LoopResponse IntervalEstimate SobolIndices consistency
        linear_covariance loop_response sobol_indices
    """,
    "gnc_opt.spacecraft": """
        J2_EARTH MU_EARTH PYRAMID_ELEVATION RADIUS_EARTH FlexibleBody
        angular_acceleration angular_momentum apply
        array_momentum cross differential_j2 divide_by_inertia
        gravity_gradient_torque hill_acceleration inertial_from_relative
        j2_gravity lvlh_rate mean_motion mrp_difference mrp_from_axis_angle mrp_rate mrp_retraction
        mrp_to_dcm mrp_to_quaternion
        point_mass_gravity quaternion_angle quaternion_conjugate quaternion_difference
        quaternion_error quaternion_product quaternion_rate quaternion_retraction
        quaternion_to_dcm radial_frame radial_frame_rate relative_acceleration
        relative_angular_acceleration relative_from_inertial
        total_momentum transpose wheel_body_acceleration wheel_pyramid
    """,
    "gnc_opt.plot": """
        View plot_controls plot_costates plot_dispersion plot_distributions
        plot_envelope plot_hamiltonian plot_motion plot_path_constraints plot_response
        plot_run plot_states
        save_figure
    """,
    "gnc_opt.report": """
        search_dict summary summary_dict write_campaign_report write_json
        write_report
    """,
}
"""What users may rely on, by package; whoever changes it changes this list."""

PUBLIC = {
    f"{package.removeprefix('gnc_opt').lstrip('.')}.{name}".lstrip("."): getattr(import_module(package), name)
    for package, names in EXPECTED.items()
    for name in names.split()
}
CLASSES = {name: value for name, value in PUBLIC.items() if inspect.isclass(value)}
FUNCTIONS = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)}
CONSTANTS = {name: value for name, value in PUBLIC.items() if name.rpartition(".")[2].isupper()}
MADE_BY_OTHERS = {gnc_opt.Phase: "Problem.phase"}
"""Classes whose constructors are not for users."""

FREE = 2
"""Parameters that a method's docstring may leave unnamed."""


def own_members(cls: type) -> dict[str, object]:
    """Public methods and properties that gnc_opt itself defines on a class, inherited ones included."""
    members: dict[str, object] = {}
    for base in reversed(cls.__mro__):
        if base.__module__.startswith("gnc_opt"):
            members |= {n: v for n, v in vars(base).items() if not n.startswith("_")}
    return {n: v for n, v in members.items() if is_documentable(v)}


def is_documentable(value: object) -> bool:
    kinds = (property, classmethod, staticmethod)
    return inspect.isfunction(value) or isinstance(value, kinds) or type(value).__name__ == "cached_property"


METHODS = [(cls, name) for cls in dict.fromkeys(CLASSES.values()) for name in own_members(cls)]


def parameters(function: object) -> list[str]:
    named = inspect.signature(function).parameters  # type: ignore[arg-type]
    return [name for name in named if name not in ("self", "cls")]


def section(doc: str, title: str) -> str:
    """The text of a numpydoc section, up to the next one."""
    lines = inspect.cleandoc(doc).splitlines()
    for i, line in enumerate(lines[:-1]):
        if line.strip() == title and set(lines[i + 1].strip()) == {"-"}:
            rest = lines[i + 2 :]
            ends = [j for j, text in enumerate(rest) if text and set(text.strip()) == {"-"}]
            return "\n".join(rest[: ends[0] - 1] if ends else rest)
    return ""


def described(doc: str, title: str) -> set[str]:
    """Names that a section describes: those at the start of unindented lines, "a, b : float"."""
    heads = [line.split(":")[0] for line in section(doc, title).splitlines() if line[:1].strip()]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def attributes(cls: type) -> set[str]:
    """Names that the instances of a class have: members, fields, and what the constructor assigns."""
    assigned = re.findall(r"self\.(\w+)(?:: [^=]+)? = ", inspect.getsource(cls))
    return {*dir(cls), *assigned, *parameters(cls)}


def complaints(rule: Callable[..., Iterator[str]], cases: Iterable[Any]) -> list[str]:
    """All that a rule has to say of so many cases: one test per rule, for a test of each would cost more than it."""
    cases = [case if isinstance(case, tuple) else (case,) for case in cases]
    assert cases
    return [
        f"{'.'.join(getattr(c, '__name__', c) for c in case)} {what}"
        for case in cases
        for what in rule(*case)
    ]


@pytest.mark.parametrize("package", EXPECTED)
def test_public_names_are_those_decided_on(package: str) -> None:
    exported = import_module(package).__all__
    assert len(set(exported)) == len(exported)
    assert set(exported) == set(EXPECTED[package].split())


@pytest.mark.parametrize("package", EXPECTED)
def test_star_import_gives_the_public_names_and_nothing_else(package: str) -> None:
    names: dict[str, object] = {}
    exec(f"from {package} import *", names)
    assert set(names) - {"__builtins__"} == set(EXPECTED[package].split())


def test_public_names_are_ours_and_not_private() -> None:
    def rule(name: str) -> Iterator[str]:
        value, last = PUBLIC[name], name.rpartition(".")[2]
        if last.startswith("_"):
            yield "is private"
        if name in CONSTANTS:
            if not isinstance(value, float):
                yield "is no number"
            return
        room, *folders = value.__module__.split(".")
        if room != "gnc_opt" or any(folder.startswith("_") for folder in folders):
            yield f"is of {value.__module__}"
        elif getattr(import_module(value.__module__), last, None) is not value:
            yield f"is another one in {value.__module__}"

    assert complaints(rule, PUBLIC) == []


def test_public_names_have_docstrings_of_their_own() -> None:
    def rule(name: str) -> Iterator[str]:
        doc = vars(PUBLIC[name]).get("__doc__") or PUBLIC[name].__doc__
        if not doc or len(doc.split()) < 3:
            yield "has no docstring"
        elif doc.startswith(f"{name.rpartition('.')[2]}("):
            yield "has only the docstring that was made for it"

    assert complaints(rule, [*CLASSES, *FUNCTIONS]) == []


def test_public_constants_have_docstrings() -> None:
    def rule(name: str) -> Iterator[str]:
        package, _, last = name.rpartition(".")
        folder = Path(import_module(f"gnc_opt.{package}").__file__ or "").parent
        if not any(
            re.search(rf'(?m)^{last} = .*\n"""', path.read_text(encoding="utf-8"))
            for path in folder.glob("*.py")
        ):
            yield "has no docstring"

    assert complaints(rule, CONSTANTS) == []


def test_public_functions_describe_parameters_and_result() -> None:
    def rule(name: str) -> Iterator[str]:
        function = FUNCTIONS[name]
        astray = described(function.__doc__, "Parameters") ^ set(parameters(function))
        if astray:
            yield f"does not describe {astray}, or has not got them"
        if function.__doc__.split()[0] != "Return" and not section(function.__doc__, "Returns"):
            yield "does not say what it returns"
        if "." not in name and not section(function.__doc__, "Raises"):  # of the first level
            yield "does not say what it raises"

    assert complaints(rule, FUNCTIONS) == []


def test_public_classes_describe_their_fields() -> None:
    def rule(name: str) -> Iterator[str]:
        cls = CLASSES[name]
        if issubclass(cls, (enum.Enum, BaseException)) or cls in MADE_BY_OTHERS:
            return
        ours = [base for base in cls.__mro__ if base.__module__.startswith("gnc_opt") and base.__doc__]
        told = {
            s: set().union(*(described(base.__doc__, s) for base in ours))
            for s in ("Parameters", "Attributes")
        }
        for missing in set(parameters(cls)) - told["Parameters"] - told["Attributes"]:
            yield f"does not describe {missing}"
        for invented in (told["Parameters"] - set(parameters(cls))) | (told["Attributes"] - attributes(cls)):
            yield f"has no {invented}"

    assert complaints(rule, CLASSES) == []


def test_public_methods_are_documented() -> None:
    """By their own docstrings, or by those of the methods that they override."""

    def rule(cls: type, name: str) -> Iterator[str]:
        versions = [vars(base)[name] for base in cls.__mro__ if name in vars(base)]
        functions = [unwrapped(member) for member in versions]
        doc = " ".join(function.__doc__ or "" for function in functions)
        if not doc.strip():
            yield "has no docstring"
        if not inspect.isfunction(versions[0]) and not isinstance(versions[0], (classmethod, staticmethod)):
            return
        classes = " ".join(
            base.__doc__ or "" for base in cls.__mro__ if base.__module__.startswith("gnc_opt")
        )
        told = set(re.findall(r"\w+", f"{doc} {classes}"))
        silent = [p for p in parameters(functions[0]) if p not in told]
        if len(silent) > FREE and not re.search(r"(as in|see) ``?[\w.]+``?", doc):
            yield f"does not describe {silent}"

    assert complaints(rule, METHODS) == []


def unwrapped(member: object) -> object:
    """The function in a property, a cached property, a class method or a static method."""
    for attribute in ("__func__", "fget", "func"):
        if getattr(member, attribute, None) is not None:
            return getattr(member, attribute)
    return member


def test_package_is_marked_as_typed() -> None:
    assert resources.files("gnc_opt").joinpath("py.typed").is_file()


def test_import_leaves_plotting_and_terminal_libraries_alone() -> None:
    heavy = "sorted({'matplotlib', 'rich', 'pytest'} & set(__import__('sys').modules))"
    done = subprocess.run(
        [sys.executable, "-c", f"import gnc_opt; print({heavy})"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
