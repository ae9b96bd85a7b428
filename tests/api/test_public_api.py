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
from importlib import import_module, resources
from pathlib import Path

import pytest

import gnc_opt

EXPECTED = {
    "gnc_opt": """
        Arc ArcKind ArgumentError Campaign ClosedLoop Condition Continuation ContinuationStatus Controller
        DesignError Experiment Explanation GncOptError History LinearCovariance LowerBound Mesh Minimum Model ModelError
        Multistart Outcome Phase
        PhaseSolution Problem ProblemError ProblemWarning Reference RefinementLimits RefinementStatus Resolver
        Result Run RunStatus
        Sensitivity Solution SolveError SolverOptions Status Sweep Table UnknownAttributeError
        UnknownNameError Verdict bound_below bryson continue_in design_ekf design_feedback_linearization
        design_hierarchical_sliding_mode design_integral_sliding_mode design_lqr design_mpc
        design_neighbouring_extremal design_neighbouring_optimal design_scheduled_ekf
        design_sliding_mode design_tvlqr design_ukf export_c export_fmu feedforward guess_from_data guess_from_solution
        linear_covariance load
        monte_carlo multistart output_feedback polish refine sensitivity simulate_guess smooth_abs solve sweep
        table table_from_csv verify verify_trajectory
    """,
    "gnc_opt.control": """
        CodeOptions ConstantRate Controller Deviation Estimator Explanation ExponentialRate Fact FilterOptions
        FlightCode GuidanceOptions
        Measurement MockupUnit PowerRate PredictiveReaching Reference SaturationLayer Sign SuperTwisting
        SuperTwistingObserver
        TanhLayer UnscentedOptions bridge_dropouts bryson decoupling_matrix design_ekf design_feedback_linearization
        design_gain_schedule design_hierarchical_sliding_mode design_integral_sliding_mode design_lqr design_mpc
        design_neighbouring_extremal design_neighbouring_optimal design_scheduled_ekf
        design_sliding_mode design_tvlqr design_ukf export_c export_fmu feedforward first_memory law
        lie_derivative output_errors output_feedback relative_degrees trim zero_dynamics
    """,
    "gnc_opt.simulation": """
        Allocation Ball Bias Block Campaign Choice ClosedLoop Consistency Constant Deadband Delay Disturbance
        Ending Envelope Event Expression Flight Hold InnovationTest Lag MinimumImpulse Mixer Noise
        NonNegativeAllocation Normal Occurrence Outage Outcome PlantFlight Pwm Pwpf Quantisation
        Quantity RandomHold
        RandomWalk RateLimit Replan Replanner Run
        RunStatus Sampling
        Saturation Scale ScaleFactor SchmittTrigger SensorDelay Sinusoid Sphere ThrusterSet Turn
        Uniform WheelArray consistency fly_plant monte_carlo
    """,
    "gnc_opt.analysis": """
        Agreement Correlations Experiment FailureProbability LinearCovariance LoopResponse Share SobolIndices WorstCase
        correlations failure_probability linear_covariance loop_response sobol_indices worst_case
    """,
    "gnc_opt.spacecraft": """
        FLATTENING_EARTH J2_EARTH MU_EARTH PYRAMID_ELEVATION RADIUS_EARTH RATE_EARTH FlexibleBody
        TetherAccelerations TetherMotion TetheredPair air_density air_temperature air_velocity
        altitude angular_acceleration angular_momentum angular_momentum_about_axis apply
        array_momentum cross differential_j2 divide_by_inertia dot drag_acceleration
        gravity_gradient_torque gravity_potential hill_acceleration inertial_from_relative
        j2_gravity lvlh_rate mean_motion mrp_difference mrp_from_axis_angle mrp_rate mrp_retraction mrp_shadow
        mrp_short mrp_to_dcm mrp_to_euler mrp_to_quaternion mrp_to_rotation orbital_energy
        point_mass_gravity quaternion_angle quaternion_conjugate quaternion_difference
        quaternion_error quaternion_from_euler quaternion_product quaternion_rate quaternion_retraction
        quaternion_to_dcm quaternion_to_rotation radial_frame radial_frame_rate relative_acceleration
        relative_angular_acceleration relative_from_inertial scale speed_of_sound stack stack_rows
        total_momentum transpose us76 wheel_body_acceleration wheel_pyramid
    """,
    "gnc_opt.plot": """
        Thruster View plot_bode plot_controls plot_costates plot_curves plot_dispersion plot_distributions
        plot_envelope plot_hamiltonian plot_margins plot_nyquist plot_path plot_refinement plot_run_controls
        plot_run_errors plot_run_states plot_sensitivity plot_states
        plot_verdict save_figure save_film
    """,
    "gnc_opt.report": """
        MessageMetadata search_dict summary summary_dict write_aem write_campaign_report write_json write_oem
        write_report write_run_report write_search
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


METHODS = [
    pytest.param(cls, name, id=f"{cls.__name__}.{name}")
    for cls in dict.fromkeys(CLASSES.values())
    for name in own_members(cls)
]


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


# --- the list -----------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", PUBLIC)
def test_public_name_is_ours_and_not_private(name: str) -> None:
    value, last = PUBLIC[name], name.rpartition(".")[2]
    assert not last.startswith("_")
    if name in CONSTANTS:
        assert isinstance(value, float)
        return
    module = value.__module__
    assert module.partition(".")[0] == "gnc_opt"
    assert not any(part.startswith("_") for part in module.split("."))
    assert getattr(import_module(module), last) is value


# --- documentation ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*CLASSES, *FUNCTIONS])
def test_public_name_has_a_docstring_of_its_own(name: str) -> None:
    doc = vars(PUBLIC[name]).get("__doc__") or PUBLIC[name].__doc__
    assert doc and len(doc.split()) >= 3, f"{name} has no docstring"
    assert not doc.startswith(f"{name.rpartition('.')[2]}("), (
        f"{name} has only the docstring that was made for it"
    )


@pytest.mark.parametrize("name", CONSTANTS)
def test_public_constant_has_a_docstring(name: str) -> None:
    package, _, last = name.rpartition(".")
    folder = Path(import_module(f"gnc_opt.{package}").__file__ or "").parent
    assert any(
        re.search(rf'(?m)^{last} = .*\n"""', path.read_text(encoding="utf-8")) for path in folder.glob("*.py")
    )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_function_describes_parameters_and_result(name: str) -> None:
    function = FUNCTIONS[name]
    assert described(function.__doc__, "Parameters") == set(parameters(function)), name
    first = function.__doc__.split()[0]
    assert first == "Return" or section(function.__doc__, "Returns"), f"{name} does not say what it returns"


@pytest.mark.parametrize("name", [n for n in FUNCTIONS if "." not in n])
def test_function_of_the_first_level_says_what_it_raises(name: str) -> None:
    assert section(FUNCTIONS[name].__doc__, "Raises"), f"{name} does not say what it raises"


@pytest.mark.parametrize("name", CLASSES)
def test_public_class_describes_its_fields(name: str) -> None:
    cls = CLASSES[name]
    if issubclass(cls, (enum.Enum, BaseException)) or cls in MADE_BY_OTHERS:
        return
    ours = [base for base in cls.__mro__ if base.__module__.startswith("gnc_opt") and base.__doc__]
    told = {
        s: set().union(*(described(base.__doc__, s) for base in ours)) for s in ("Parameters", "Attributes")
    }
    missing = set(parameters(cls)) - told["Parameters"] - told["Attributes"]
    assert not missing, f"{name} does not describe {missing}"
    assert told["Parameters"] <= set(parameters(cls)), (
        f"{name} has no {told['Parameters'] - set(parameters(cls))}"
    )
    assert told["Attributes"] <= attributes(cls), f"{name} has no {told['Attributes'] - attributes(cls)}"


@pytest.mark.parametrize(("cls", "name"), METHODS)
def test_public_method_is_documented(cls: type, name: str) -> None:
    """By its own docstring, or by that of the method that it overrides."""
    versions = [vars(base)[name] for base in cls.__mro__ if name in vars(base)]
    functions = [unwrapped(member) for member in versions]
    doc = " ".join(function.__doc__ or "" for function in functions)
    assert doc.strip(), f"{cls.__name__}.{name} has no docstring"
    if not inspect.isfunction(versions[0]) and not isinstance(versions[0], (classmethod, staticmethod)):
        return
    classes = " ".join(base.__doc__ or "" for base in cls.__mro__ if base.__module__.startswith("gnc_opt"))
    told = set(re.findall(r"\w+", f"{doc} {classes}"))
    silent = [p for p in parameters(functions[0]) if p not in told]
    assert len(silent) <= FREE or re.search(r"(as in|see) ``?[\w.]+``?", doc), (
        f"{cls.__name__}.{name} does not describe {silent}"
    )


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
