"""hp refinement: better meshes until the error between the nodes is small."""
