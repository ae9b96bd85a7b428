"""hp mesh refinement."""
