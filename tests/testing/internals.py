"""Internal names of the package that several test files use: a moved module changes this file alone."""
# ruff: noqa: F401

from gnc_opt.control.horizon_qp import Rows
from gnc_opt.control.quadratic_cost import QuadraticCost
from gnc_opt.control.sampled_data import sample, zero_order_hold
from gnc_opt.planning.nlp import NlpSolver
from gnc_opt.planning.nlp.separable import PointBlock, PointFunction, SeparableProgram
from gnc_opt.planning.problem.arcs import Held, Smooth
from gnc_opt.planning.problem.functions import PhaseFunctions, phase_functions
from gnc_opt.planning.problem.guess.initial_guess import start_phase
from gnc_opt.planning.problem.interval import Interval, free
from gnc_opt.planning.problem.reformulation import restated
from gnc_opt.planning.solution.history import Statistics
from gnc_opt.planning.solution.polynomial import PiecewisePolynomial
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.warm_start import start_from_guess
from gnc_opt.planning.transcription.collocation import PhaseCollocation
from gnc_opt.planning.transcription.mesh import DEFAULT_MESH
from gnc_opt.planning.transcription.quadrature import collocation_rule
from gnc_opt.planning.transcription.scheme import SCHEMES, Scheme
from gnc_opt.planning.transcription.transcription import Transcription, transcribe
from gnc_opt.plot.style import new_figure
from gnc_opt.report.verdict_table import verdict_text
from gnc_opt.simulation.confidence_intervals import pass_rate
from gnc_opt.simulation.dispersions import Dispersion
from gnc_opt.simulation.dormand_prince import dormand_prince
from gnc_opt.simulation.intersample_input import Wave
