"""Internal names of the package that several test files use: a moved module changes this file alone."""
# ruff: noqa: F401

from gnc_opt.analysis.closed_loop_linearization import Linearization
from gnc_opt.control.c_export.c_statement_generation import FLOAT
from gnc_opt.control.control_limits_and_authority import clip_to_limits, read_control_limits, saturate_command
from gnc_opt.control.input_output_linearization import PlantPair, build_output_error_expressions
from gnc_opt.control.loop_margins import compute_stability_margins
from gnc_opt.control.mpc_horizon_qp import QuadraticProgram, StepLimits
from gnc_opt.control.quadratic_cost import QuadraticCost, read_quadratic_cost, read_weight_matrix
from gnc_opt.control.reaching_laws import read_disturbance_bounds
from gnc_opt.control.riccati import (
    compute_riccati_residual,
    find_uncontrollable_modes,
    require_stabilizable,
    solve_algebraic_riccati,
)
from gnc_opt.control.sampled_data_discretization import (
    advance_step_counter,
    compute_spectral_radius,
    count_steps_in_duration,
    count_steps_started_within_duration,
    discretize_plant_and_cost,
    discretize_time_varying_plant,
    discretize_zero_order_hold,
    is_step_counter_zero,
)
from gnc_opt.control.super_twisting_observer import check_super_twisting_gains
from gnc_opt.control.tvlqr_gains import compute_riccati_gains
from gnc_opt.estimation.error_state_coordinates import build_euclidean_error_coordinates
from gnc_opt.estimation.jacobian_and_sigma_point_linearization import (
    SigmaRegression,
    factorise_semidefinite,
    solve_triangular_left,
    solve_triangular_right,
)
from gnc_opt.guidance.trajectory_replanning import build_remaining_problem, check_remaining_problem
from gnc_opt.planning.direct.computation_budget import WORK_PER_SECOND, WorkBudget
from gnc_opt.planning.direct.fixed_mesh_solve import (
    FIXED_TIME_FACTORS,
    generate_feasibility_initial_points,
    has_trajectory_guess,
    solve_problem_on_mesh,
)
from gnc_opt.planning.direct.scaled_nlp_setup import ScaledNlp
from gnc_opt.planning.nlp import NlpPoint, NlpResult, NlpSolver
from gnc_opt.planning.nlp.partially_separable_nlp import PointFunction, PointTerm, SeparableProgram
from gnc_opt.planning.optimality.active_state_constraints import PureStateConstraints, StateConstraints
from gnc_opt.planning.optimality.controllability_gramian import Ellipsoid
from gnc_opt.planning.optimality.multiplier_estimate import estimate_multipliers
from gnc_opt.planning.optimality.optimality_check_scales import (
    BoundaryChanges,
    EndPoints,
    PhaseScales,
    Scales,
)
from gnc_opt.planning.optimality.switching_time_problem import Switches
from gnc_opt.planning.optimality.trajectory_interpolation import SampledPhase, fit_trajectory_polynomials
from gnc_opt.planning.problem.active_constraint_arcs import FixedArcs, Junction, SmoothControl
from gnc_opt.planning.problem.bounds import Interval, unbounded_interval
from gnc_opt.planning.problem.guess import simulated_guess as guess_simulation
from gnc_opt.planning.problem.guess.initial_guess import (
    SUSTAINED,
    build_phase_guess,
    guess_boundary_states,
    guess_phase_times,
)
from gnc_opt.planning.problem.guess.simulated_guess import with_simulated_guess
from gnc_opt.planning.problem.guess.singularity_avoidance import with_curved_guess
from gnc_opt.planning.problem.hamiltonian_functions import PhaseFunctions, compile_phase_functions
from gnc_opt.planning.problem.interval_arithmetic import bound_function_values
from gnc_opt.planning.problem.redundant_bounds import find_implied_bounds, find_monotone_states
from gnc_opt.planning.problem.reformulation import reformulate_problem
from gnc_opt.planning.problem.scaling_magnitudes import (
    UNBOUNDED_STATE_MAX_RATIO,
    estimate_state_and_control_magnitudes,
)
from gnc_opt.planning.refinement.arcs.arc_mesh import (
    ARC_MAX_DEGREE,
    ARC_MAX_SEGMENTS,
    FIRST_DEGREE,
    ArcMesh,
    SubarcMesh,
)
from gnc_opt.planning.refinement.arcs.control_structure import PhaseStructure
from gnc_opt.planning.refinement.arcs.structure_detection import detect_control_structure
from gnc_opt.planning.refinement.arcs.switching_time_optimization import optimise_switching_times
from gnc_opt.planning.refinement.collocation_error_estimate import estimate_segment_errors
from gnc_opt.planning.refinement.hp_refinement import refine_mesh
from gnc_opt.planning.solution.defects_and_violations import (
    Worst,
    integrate_dynamics,
)
from gnc_opt.planning.solution.initial_nlp_point import build_nlp_point_from_guess
from gnc_opt.planning.solution.phase_solution import interpolate_point_values
from gnc_opt.planning.solution.phase_trajectory_samples import PhaseSamples
from gnc_opt.planning.solution.piecewise_polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.refinement_history import RefinementIteration, Statistics
from gnc_opt.planning.solution.solution_from_nlp_result import unwrap_angles
from gnc_opt.planning.solution.state_and_control_scales import compute_control_scales
from gnc_opt.planning.study.kkt_sensitivity import predict_solution, solve_with_tighter_tolerance
from gnc_opt.planning.transcription.arc_constraints import (
    build_polynomial_control_constraints,
    check_number_of_arc_segments,
    impose_control_limits_on_arcs,
    impose_path_limits_on_arcs,
    impose_state_limits_on_arcs,
)
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.collocation_families import SCHEMES, Scheme, get_point_family
from gnc_opt.planning.transcription.mesh import DEFAULT_MESH
from gnc_opt.planning.transcription.quadrature import get_collocation_rule
from gnc_opt.planning.transcription.scaling import NEARBY_SHIFT, choose_row_scales, choose_variable_scales
from gnc_opt.planning.transcription.transcription import Transcription, transcribe_problem
from gnc_opt.planning.verification.bang_bang_second_order_conditions import (
    check_strict_bang_bang_property,
    explain_why_not_bang_bang,
)
from gnc_opt.planning.verification.external_trajectory_check import _build_sampled_solution
from gnc_opt.planning.verification.optimality_check import CONDITION_TOLERANCE, check_second_order_conditions
from gnc_opt.planning.verification.solution_data_check import get_endpoint_gradients, recompute_stored_data
from gnc_opt.plot.animated_3d_scene import render_3d_scene_html
from gnc_opt.plot.campaign_figures import plot_run_controls, plot_run_envelopes
from gnc_opt.plot.figure_style import create_figure_with_axes_rows, format_unit, format_variable_name
from gnc_opt.plot.vehicle_motion_sampling import get_motion_time_span, sample_vehicle_motion
from gnc_opt.report.campaign_report import build_campaign_conclusion
from gnc_opt.report.constraint_margins import list_limit_margins
from gnc_opt.report.html_report_document import (
    build_html_document,
    embed_svg_figure,
    get_running_command_line,
    read_figure_captions,
)
from gnc_opt.report.mathml_formulas import (
    Formulas,
    typeset_component_names,
    typeset_names_in_html,
    typeset_variable_name,
)
from gnc_opt.report.problem_statement_html import format_docstring_as_html, format_problem_statement
from gnc_opt.report.switching_structure_margins import (
    iterate_control_structure_margins,
    list_margins_of_control_arcs,
    select_largest_risks,
)
from gnc_opt.simulation.block_signal_chain import ColumnLayout, connect_block_chain
from gnc_opt.simulation.campaign_performance_measures import compute_percentile_envelope
from gnc_opt.simulation.confidence_intervals import (
    estimate_pass_rate,
    estimate_percentile,
    share_below_maximum,
)
from gnc_opt.simulation.control_allocation import (
    _limit_null_space_torque,
    find_null_space_vector,
    minimise_peak_along_null_vector,
    pseudo_inverse,
    read_effectiveness_matrix,
)
from gnc_opt.simulation.control_step_execution import StepExecutor
from gnc_opt.simulation.dispersions import Dispersion, check_dispersions, draw_dispersed_parameters
from gnc_opt.simulation.dormand_prince import NODES, STAGES, IntegrationStep, integrate_dormand_prince
from gnc_opt.simulation.final_states_and_integration_error import estimate_integration_errors
from gnc_opt.simulation.intersample_actuator_output import ActuatorWaveform, stack_actuator_waveforms
from gnc_opt.simulation.monte_carlo import SuccessCriteria, read_success_criteria
from gnc_opt.simulation.recorded_extremes_and_integrals import MAX_SAMPLES, select_quantity_sample_steps
from gnc_opt.simulation.sensor_and_actuator_block import StepContext
from gnc_opt.simulation.simulation_run_results import LoggedSignal, compute_settling_time
from gnc_opt.simulation.step_size_selection import MAX_SUBSTEPS, count_steps_for_accuracy
from gnc_opt.simulation.zero_crossing_location import EventDetector
from gnc_opt.text_html_and_json_formatting import format_unit_quotient
