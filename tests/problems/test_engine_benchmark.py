"""The benchmark of the solver on all problems: its independent program, what it counts, and its limit of CPU time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.validation import engine, engine_page
from benchmarks.validation.engine import Case
from benchmarks.validation.reference_collocation import collocate, radau
from gnc_opt.problem_files_and_examples import find_example, list_examples


def test_radau_rule_is_exact_for_its_degree() -> None:
    points, slopes, weights = radau(4)
    for power in range(7):  # 2 K - 2
        assert weights @ points**power == pytest.approx(1 / (power + 1), abs=1e-13)
    for power in range(5):
        values = np.r_[0.0, points] ** power
        np.testing.assert_allclose(slopes @ values, power * points ** max(power - 1, 0), atol=1e-11)


@pytest.mark.parametrize(
    ("name", "relative"),
    [
        ("zermelo", 1e-10),
        ("interior_point", 1e-8),  # two phases
        ("edelbaum_transfer", 1e-10),
        ("elliptic_rendezvous", 1e-8),  # an integral as cost
        ("cannonball", 1e-8),  # a free parameter, no control
    ],
)
def test_independent_program_finds_known_optima(name: str, relative: float) -> None:
    """From the statement's guess, then warm on a finer mesh."""
    module = find_example(name).module
    coarse = collocate(module.build(), 10, 5)
    fine = collocate(module.build(), 25, 5, coarse)
    assert coarse.solved and fine.solved
    assert fine.objective == pytest.approx(module.REFERENCE.value, rel=relative)


def test_every_file_has_a_group() -> None:
    names = {each.name for each in list_examples() if not each.is_package}
    groups = {name: engine.group_of(find_example(name)) for name in names}
    assert sum(group == "flagship" for group in groups.values()) == 26
    assert sum(group == "gallery" for group in groups.values()) == 30
    assert engine.group_of(find_example("rendezvous")) == "gallery"


def test_a_problem_is_stopped_at_its_limit_and_the_next_one_is_solved(tmp_path: Path) -> None:
    cases = [Case("further", "six_dof_landing"), Case("gallery", "zermelo")]
    late, right = (
        next(iter(engine.run([case], tmp_path, limit))) for case, limit in zip(cases, (1, 60), strict=True)
    )
    assert late.note == "stopped at the limit of CPU time" and not late.right
    assert right.right and right.ok and right.minimum
    assert right.true is not None and right.true < 1e-8


def test_the_page_shows_every_problem_with_picture_and_result() -> None:
    text = engine_page.PAGE.read_text(encoding="utf-8")
    written = text[text.index(engine_page.BEGIN) : text.rindex(engine_page.END)]
    for each in list_examples():
        place = f"problems/{each.path.parent.name}/{each.path.name})"
        rows = [line for line in written.splitlines() if place in line]
        assert len(rows) == (not each.is_package), each.name
        for row in rows:
            assert f"(pictures/{each.name}.png)" in row
            assert (engine_page.PAGE.parent / "pictures" / f"{each.name}.png").exists()
            assert all(cell.strip() for cell in row.strip("| ").split(" | "))


@pytest.mark.parametrize(
    ("row", "shown"),
    [
        (engine.Row("", "zermelo", ok=True, minimum=True), "optimum"),
        (engine.Row("", "zermelo", ok=True), "necessary conditions"),
        (
            engine.Row("", "zermelo", note="active set 1.0e-05; dynamics 2.3e-02"),
            "**fails**: active set, dynamics",
        ),
        (engine.Row("", "zermelo", note="diverged"), "**fails**: diverged"),
    ],
)
def test_the_table_names_conditions_that_fail(row: engine.Row, shown: str) -> None:
    assert list(engine_page._cells(find_example("zermelo"), row))[-1] == shown
