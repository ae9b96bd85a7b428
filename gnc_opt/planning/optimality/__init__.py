"""Mathematics of the optimality conditions, shared by verification, refinement and sensitivity."""
