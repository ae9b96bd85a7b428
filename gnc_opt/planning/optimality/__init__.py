"""Optimality theory: quantities shared by the optimality check, refinement and sensitivity analysis."""
