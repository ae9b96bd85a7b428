"""gnc_opt: one solve on a mesh, and refined to 1e-8 with the verdict."""

import plain

import gnc_opt as go
from problems.rendezvous import build


def once(mesh):
    return lambda case: go.solve(build(case), mesh=mesh, tol=None).objective


def certified(mesh):
    return lambda case: go.solve(build(case), mesh=mesh, tol=1e-8).objective


if __name__ == "__main__":
    certified("10x3")(1)  # loads what is loaded when it is first used
    ways = {mesh: once(mesh) for mesh in ("10x3", "20x3", "60x4")}
    plain.report({**ways, **{f"{mesh}, certified": certified(mesh) for mesh in ("10x3", "20x3")}})
