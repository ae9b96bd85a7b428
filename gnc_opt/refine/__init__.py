"""Refinement: meshes, control structure, exact switch times."""
