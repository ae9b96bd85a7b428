"""Solutions on disk: every bit comes back, strangers' files are refused."""

import dataclasses
import io
import json
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from testing.bitwise_equality import assert_same

import gnc_opt as go
from gnc_opt.errors import GncOptError, ProblemError
from gnc_opt.planning.solution.solution import SOLUTION_FILES


def pendulum(gravity: float = 9.81, reach: float = 1.0) -> go.Problem:
    """Vector states, a path constraint, an integral, a model and a free parameter, in two phases."""
    model = go.Model("pendulum")
    x = model.state("x", 2, unit="rad")
    u = model.control("u", unit="N m")
    damping = model.parameter("damping", 0.1)
    model.ode({x: ca.vertcat(x[1], u - gravity * ca.sin(x[0]) - damping * x[1])})
    problem = go.Problem("swing")
    stretch = problem.parameter("stretch", lower=0.5, upper=2.0, guess=1.0)
    first, second = problem.phase("first", model), problem.phase("second", model)
    first.time(initial=0.0, final=0.5)
    second.time(initial=(0.0, 5.0), final=1.0)
    first.initial(x=[0.0, 0.0])
    first.bounds(u=(-9.0, 9.0), x=([-3.0, -9.0], [3.0, 9.0]))
    first.path("power", u * x[1], upper=8.0)
    second.final(x=[0.4 * reach, 0.0])
    problem.link(first, second)
    problem.constrain("fair", stretch, lower=0.9)
    problem.minimize(first.integral(u**2, name="effort") + second.integral(u**2) + (stretch - 0.7) ** 2)
    return problem


MESH = {"first": go.Mesh((0.0, 0.2, 0.5, 1.0), (3, 5, 4)), "second": go.Mesh.uniform(2, 4)}


@pytest.fixture(scope="module")
def solution() -> go.Solution:
    return go.solve(pendulum(), mesh=MESH, tol=None)


@pytest.fixture
def file(solution: go.Solution, tmp_path: Path) -> Path:
    return solution.save(tmp_path / "swing.npz")


def rewrite(file: Path, change: Any) -> None:
    """Apply ``change(entries)`` to the entries of an archive."""
    with np.load(file) as archive:
        entries = {name: archive[name] for name in archive.files}
    change(entries)
    np.savez(file, **entries)


def edit_header(file: Path, change: Any) -> None:
    def edit(entries: dict[str, Any]) -> None:
        header = json.loads(str(entries["header"]))
        change(header)
        entries["header"] = np.array(json.dumps(header))

    rewrite(file, edit)


@pytest.mark.parametrize("scheme", ["LG", "LGR", "LGL"])
def test_round_trip_keeps_every_bit(scheme: Any, tmp_path: Path) -> None:
    solution = go.solve(pendulum(), mesh=MESH, scheme=scheme, tol=None)
    loaded = go.load(solution.save(tmp_path / "swing.npz"))
    assert_same(solution, loaded)
    assert_same(solution.accuracy, loaded.accuracy)
    for name, leg in solution.phases.items():
        times, other = leg.sample_times(), loaded.phase(name)
        multipliers = ("path_multiplier", "state_multiplier", "control_multiplier")
        for signal in ("x", "u", "lam", "applied", *multipliers):
            here, there = getattr(leg, signal)(times), getattr(other, signal)(times)
            assert here.tobytes() == there.tobytes(), signal


def test_numbers_that_are_not_finite_come_back(solution: go.Solution, tmp_path: Path) -> None:
    failed = dataclasses.replace(
        solution, objective=float("nan"), violations=(go.planning.solution.Violation("row", float("inf")),)
    )
    loaded = go.load(failed.save(tmp_path / "failed.npz"))
    assert np.isnan(loaded.objective)
    assert loaded.violations[0].amount == float("inf")


def test_failed_solve_can_be_saved(tmp_path: Path) -> None:
    failed = go.solve(
        pendulum(), mesh=MESH, options=go.SolverOptions(max_iterations=2), throw=False, tol=None
    )
    assert not failed.status.solved
    loaded = go.load(failed.save(tmp_path / "failed.npz"))
    assert loaded.status is failed.status
    assert loaded.violations == failed.violations


def test_loaded_without_the_problem(solution: go.Solution, file: Path) -> None:
    loaded = go.load(file)
    assert loaded.problem is None
    assert loaded.state("x", "first")(0.3) == pytest.approx(solution.state("x", "first")(0.3), abs=0)
    assert loaded.costate("x", "second")(0.8) == pytest.approx(solution.costate("x", "second")(0.8), abs=0)
    assert loaded.saturated_control("u", "first")(0.1) == solution.saturated_control("u", "first")(0.1)
    assert loaded.parameter("stretch") == solution.parameter("stretch")
    assert loaded.multiplier("fair") == solution.multiplier("fair")
    assert loaded.provenance == solution.provenance
    assert not loaded.phase("first").lam_start.flags.writeable
    with pytest.raises(GncOptError, match=r"without its problem: load it with load\(path, problem=\.\.\.\)"):
        loaded.hamiltonian(0.1, "first")


def test_print_says_that_the_accuracy_is_that_of_saving_time(solution: go.Solution, file: Path) -> None:
    loaded = go.load(file)
    assert f"{solution.accuracy.defect:.2g} (relative)" in str(loaded)
    assert "(when it was saved)" in str(loaded)
    assert "(when it was saved)" not in str(go.load(file, problem=pendulum()))
    # Saved once more, still without the problem, the figures are carried over.
    again = go.load(loaded.save(file.with_name("again.npz")))
    assert again.accuracy == solution.accuracy


def test_an_accuracy_that_nobody_measured_is_not_invented(solution: go.Solution, tmp_path: Path) -> None:
    bare = dataclasses.replace(solution, problem=None)
    loaded = go.load(bare.save(tmp_path / "bare.npz"))
    assert "unknown: load the solution with its problem" in str(loaded)


def test_loaded_with_the_problem(solution: go.Solution, file: Path) -> None:
    loaded = go.load(file, problem=pendulum())
    times = np.linspace(0.0, 0.5, 7)
    assert np.array_equal(loaded.hamiltonian(times, "first"), solution.hamiltonian(times, "first"))
    assert loaded.accuracy == solution.accuracy
    warm = go.solve(pendulum(), guess=loaded, check=False)
    assert warm.objective == pytest.approx(solution.objective, rel=1e-9)


def test_another_problem_is_refused(file: Path) -> None:
    with pytest.raises(ProblemError, match="problem 'swing' is not the one"):
        go.load(file, problem=pendulum(reach=0.9))
    # A constant inside an expression, off in its eighth digit.
    with pytest.raises(ProblemError, match="problem 'swing' is not the one"):
        go.load(file, problem=pendulum(gravity=9.8100001))


def test_path_gets_a_suffix_only_if_it_has_none(solution: go.Solution, tmp_path: Path) -> None:
    assert solution.save(tmp_path / "a") == tmp_path / "a.npz"
    assert solution.save(str(tmp_path / "b.sol")) == tmp_path / "b.sol"
    assert sorted(os.listdir(tmp_path)) == ["a.npz", "b.sol"]
    assert go.load(tmp_path / "b.sol").objective == solution.objective


def test_saving_twice_gives_the_same_bytes(solution: go.Solution, tmp_path: Path) -> None:
    first, second = solution.save(tmp_path / "a"), solution.save(tmp_path / "b")
    assert first.read_bytes() == second.read_bytes()


def test_file_is_readable_with_numpy_alone(solution: go.Solution, file: Path) -> None:
    with np.load(file, allow_pickle=False) as archive:
        header = json.loads(
            str(archive["header"]), parse_constant=pytest.fail
        )  # NaN and Infinity are no JSON
        assert np.array_equal(archive["phases.first.lam_start"], solution.phase("first").lam_start)
    assert (header["format"], header["version"]) == ("gnc_opt solution", SOLUTION_FILES.version)


def test_numbers_that_json_does_not_know_come_back(solution: go.Solution, tmp_path: Path) -> None:
    for value in (np.inf, -np.inf, np.nan, 0.1):
        file = dataclasses.replace(solution, objective=value).save(tmp_path / "n.npz")
        with np.load(file) as archive:
            json.loads(str(archive["header"]), parse_constant=pytest.fail)
        assert_same(go.load(file).objective, value)


def test_number_of_entries_does_not_grow_with_the_mesh(solution: go.Solution, tmp_path: Path) -> None:
    fine = go.solve(pendulum(), mesh="12x3", tol=None)
    names = [set(np.load(s.save(tmp_path / "f.npz")).files) for s in (solution, fine)]
    assert names[0] == names[1]


def test_failed_write_leaves_the_old_file(
    solution: go.Solution, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = file.read_bytes()

    def break_down(stream: io.BufferedWriter, **_: Any) -> None:
        stream.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", break_down)
    with pytest.raises(OSError, match="disk full"):
        solution.save(file)
    assert file.read_bytes() == before
    assert os.listdir(file.parent) == [file.name]


def test_missing_folder_and_missing_file(solution: go.Solution, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        solution.save(tmp_path / "nowhere" / "a.npz")
    with pytest.raises(FileNotFoundError, match=r"absent\.npz"):
        go.load(tmp_path / "absent.npz")


@pytest.mark.parametrize("content", [b"", b"hello", pickle.dumps({"a": 1}), b"\x93NUMPY garbage"])
def test_foreign_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    path.write_bytes(content)
    with pytest.raises(GncOptError, match=r"foreign\.npz' is not a solution of gnc_opt"):
        go.load(path)


def test_foreign_archives_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x=np.zeros(3))
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    np.savez(tmp_path / "c.npz", header=np.array(json.dumps({"format": "other", "version": 1})))
    np.savez(tmp_path / "d.npz", header=np.array("[1, 2]"))
    for name in "abcd":
        with pytest.raises(GncOptError, match="is an archive, but not a solution of gnc_opt"):
            go.load(tmp_path / f"{name}.npz")


def test_truncated_file_is_refused(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(GncOptError, match="not a solution of gnc_opt, or only part of one"):
        go.load(file)


def test_flipped_bytes_are_noticed(file: Path) -> None:
    """Every entry has a checksum: where a byte flips, loading fails or (names, dates) nothing changes."""
    content = file.read_bytes()
    original = go.load(file)
    refused = 0
    for place in range(40, len(content), len(content) // 40):
        broken = bytearray(content)
        broken[place] ^= 0xFF
        file.write_bytes(bytes(broken))
        try:
            assert_same(original, go.load(file))
        except GncOptError:
            refused += 1
    assert refused >= 20


def test_flipped_bits_of_the_archive_itself_are_noticed(file: Path) -> None:
    """Flags (encryption, patches) and method in the directory of the zip format: refused in our words, or harmless."""
    content = file.read_bytes()
    original = go.load(file)
    place = content.index(b"PK\x01\x02") + 8
    refused = 0
    for bit in range(32):
        broken = bytearray(content)
        broken[place + bit // 8] ^= 1 << bit % 8
        file.write_bytes(bytes(broken))
        try:
            assert_same(original, go.load(file))
        except GncOptError as error:
            refused += 1
            assert str(file) in str(error)
    assert refused >= 16 + 3  # every other method; encryption, patched data, strong encryption


@pytest.mark.parametrize(
    "failure", [NotImplementedError, RuntimeError, MemoryError, ValueError, EOFError, zipfile.BadZipFile]
)
@pytest.mark.parametrize("place", ["is_zipfile", "ZipFile"])
def test_whatever_a_damaged_file_raises_becomes_our_error(
    file: Path, monkeypatch: pytest.MonkeyPatch, place: str, failure: type[Exception]
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise failure("from below")

    monkeypatch.setattr(zipfile, place, fail)
    with pytest.raises(GncOptError, match=r"swing\.npz' is damaged"):
        go.load(file)


def test_an_entry_that_does_not_match_its_checksum_is_noticed(file: Path) -> None:
    """NumPy reads as many numbers as the entry's own header announces, and so may never reach the checksum."""
    with np.load(file) as archive:
        entries = {name: archive[name] for name in archive.files}
    entries["surplus"] = np.zeros(9999)
    np.savez(file, **entries)  # not compressed
    go.load(file)
    file.write_bytes(file.read_bytes().replace(b"'shape': (9999,)", b"'shape': (1111,)"))
    with pytest.raises(GncOptError, match="is damaged"):
        go.load(file)


def test_other_versions_are_refused(file: Path) -> None:
    edit_header(file, lambda header: header.update(version=99, written_by="7.0"))
    with pytest.raises(GncOptError, match=r"format version 99 \(gnc_opt 7\.0\).*reads version 4"):
        go.load(file)


@pytest.mark.parametrize(
    "change",
    [
        lambda header: header.pop("solution"),
        lambda header: header.update(solution=None),
        lambda header: header["solution"].update(type="Path"),
        lambda header: header["solution"].update(type="Interval"),
        lambda header: header["solution"]["fields"].update(surprise=1),
        lambda header: header["solution"]["fields"].pop("status"),
        lambda header: header["solution"]["fields"]["status"].update(value="fine"),
        lambda header: header["solution"]["fields"].update(parameter_values={"array": "elsewhere"}),
    ],
)
def test_damaged_headers_are_refused(file: Path, change: Any) -> None:
    edit_header(file, change)
    with pytest.raises(GncOptError, match=r"swing\.npz' is damaged"):
        go.load(file)


def test_nothing_is_unpickled(file: Path) -> None:
    class Trap:
        def __reduce__(self) -> Any:
            return (pytest.fail, ("code in a file was run",))

    rewrite(file, lambda entries: entries.update(parameter_values=np.array([Trap()], dtype=object)))
    with pytest.raises(GncOptError, match="is damaged"):
        go.load(file)


@pytest.mark.parametrize(("version", "lacking"), [(1, ("turns", "composed_controls")), (2, ("turns",))])
def test_files_of_older_versions_are_read(file: Path, version: int, lacking: tuple[str, ...]) -> None:
    def older(header: dict[str, Any]) -> None:
        header["version"] = version
        for phase in header["solution"]["fields"]["phases"]["map"].values():
            for name in lacking:
                del phase["fields"][name]

    now = go.load(file)
    edit_header(file, older)
    first = go.load(file)
    assert first.objective == now.objective and first.accuracy == now.accuracy
    assert [leg.composed_controls for leg in first.phases.values()] == [()] * len(first.phases)


def test_stored_classes_belong_to_this_version() -> None:
    """A change here changes what is in the files: raise SOLUTION_FILES.version, then adapt this list."""
    packing = SOLUTION_FILES.packing
    known = {
        kind.__name__: " ".join(packing.list_saved_dataclass_fields(kind))
        for kind in packing.classes
        if dataclasses.is_dataclass(kind)
    }
    assert SOLUTION_FILES.version == 4
    assert known["Mesh"] == "breaks degrees movable"
    assert known["Solution"] == (
        "problem_name status objective maximised phases free_parameters parameter_values "
        "parameter_multipliers constraint_labels constraint_values constraint_multipliers violations "
        "statistics provenance structure"
    )
    assert known["PhaseSolution"] == (
        "name scheme mesh initial_time final_time states controls model_parameters path_labels "
        "integral_labels x u lam lam_start lam_end point_costates path_multipliers state_multipliers "
        "control_multipliers "
        "state_impulses time_multipliers duration_multiplier integrals integral_weights parameters "
        "state_bounds control_bounds path_bounds initial_bounds final_bounds initial_time_bounds "
        "final_time_bounds duration_bounds composed_controls turns"
    )
