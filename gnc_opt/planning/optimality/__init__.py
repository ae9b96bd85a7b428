"""Mathematics of the optimality conditions, shared by the optimality check, refinement and sensitivity."""
