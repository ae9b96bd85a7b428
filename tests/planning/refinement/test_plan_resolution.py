"""How finely the structure loop begins: coarsely, unless the mesh it got is finer than the default."""

from dataclasses import replace

import numpy as np
import pytest
from testing.internals import ARC_MAX_DEGREE, FIRST_DEGREE, PhaseStructure, Plan, Resolution, points_of

from gnc_opt.planning import ArcKind, Mesh

LOW, UP = ArcKind.LOWER, ArcKind.UPPER


def test_points_of_a_mesh_count_its_coarsest_segment() -> None:
    assert abs(points_of(Mesh.uniform(60, 3)) - 180) < 1e-9
    assert abs(points_of(Mesh((0.0, 0.5, 0.55, 1.0), (9, 3, 9))) - 18) < 1e-12


STRUCTURE = PhaseStructure((0.0, 9.25, 10.0), ((UP,), (LOW,)))
"""One control with a long and a short bang arc."""


def test_long_pieces_of_a_fine_mesh_get_more_segments() -> None:
    coarse, fine = Plan.of(STRUCTURE, 80.0), Plan.of(STRUCTURE, 180.0)
    assert [(r.segments, r.degree) for r in coarse.resolutions] == [(1, FIRST_DEGREE)] * 2
    assert [(r.segments, r.degree) for r in fine.resolutions] == [(10, ARC_MAX_DEGREE), (1, FIRST_DEGREE)]
    assert fine.points == 180.0


@pytest.mark.parametrize("smooth", [0, 8])
def test_segments_that_are_halved_meet_where_they_met(smooth: int) -> None:
    """Those that a refined mesh left, too, whose boundaries are told one by one."""
    kept = Resolution(3, ARC_MAX_DEGREE, smooth, edges=(0.2, 0.7))
    finer = kept.finer(np.full(3, 1.0))
    assert finer.segments == 6 and finer.smooth == smooth
    assert finer.shares == pytest.approx([0.0, 0.1, 0.2, 0.45, 0.7, 0.85, 1.0])
    plan = Plan.of(STRUCTURE, 80.0)
    refined = replace(plan, resolutions=(finer, Resolution()))
    assert refined.mesh().degrees == (ARC_MAX_DEGREE,) * 6 + (FIRST_DEGREE,)
