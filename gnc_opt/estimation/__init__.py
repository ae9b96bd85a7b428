"""Kalman filters, and output feedback of their estimates."""

from gnc_opt.estimation.estimator_and_output_feedback import Estimator, output_feedback
from gnc_opt.estimation.kalman_filter_design import design_ekf, design_ukf
from gnc_opt.estimation.measurement_model import FilterOptions, Measurement

__all__ = ["Estimator", "FilterOptions", "Measurement", "design_ekf", "design_ukf", "output_feedback"]
