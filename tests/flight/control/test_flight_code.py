"""Flight code: compiles without warnings and agrees with Python."""

import re
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from testing.c_compiler import (
    NO_C,
    compiled,
    follower,
    holder,
    law_of,
    needs_compiler,
    pendulum,
    python,
    run,
    sanitized,
    scalar_operations,
)
from testing.internals import StepLimits

import gnc_opt as go
from gnc_opt.control import (
    Controller,
    DesignReport,
    design_lqr,
    export_c,
    initial_state_function,
    law_function,
)
from gnc_opt.control.c_export.c_code_export import (
    _escape_c_comment,
    _make_c_identifier,
    _read_c_identifier_prefix,
    _write_c_comments_of_signals,
)
from gnc_opt.control.c_export.c_statement_generation import (
    DOUBLE,
    wrap_c_initializer_lines,
    write_c_statements,
)
from gnc_opt.control.c_export.c_table_of_references_and_gains import tabulate_references_and_gains
from gnc_opt.errors import ArgumentError
from gnc_opt.model import Layout, Model, Variable


@needs_compiler
@pytest.mark.parametrize(
    ("design", "own", "dt"),
    [(follower, None, 0.1), (follower, 0.2, None), (holder, None, 0.05), (holder, 0.1, None)],
)
def test_compiled_law_agrees_with_python(tmp_path, design, own, dt):
    controller = design(own)
    code = export_c(controller, tmp_path / "flight", dt=dt)
    program = compiled(code)
    rng = np.random.default_rng(5)
    times = 0.5 + code.dt * np.arange(80)  # beyond the end of the reference
    states = rng.normal(size=(80, 2))
    expected = python(controller, times, states, code.dt)
    assert np.ptp(expected) > 1
    assert np.allclose(run(program, times, states), expected, rtol=1e-12, atol=1e-12)
    example = subprocess.run([str(program), "example"], check=True, capture_output=True, text=True)
    first = controller.span[0]
    same = python(controller, first + code.dt * np.arange(3), np.full((3, 2), 0.1), code.dt)
    assert np.allclose(np.array(example.stdout.split(), dtype=float), same.ravel(), rtol=1e-12, atol=1e-12)


@needs_compiler
def test_times_between_the_rows_take_the_row_of_their_step(tmp_path):
    controller = follower(0.2)
    program = compiled(export_c(controller, tmp_path))
    x = np.array([0.4, 0.1])
    late = run(program, [0.9 + 0.19, 0.9, 99.0, 0.0], [x] * 4)
    assert np.array_equal(late[0], late[1])
    assert np.allclose(late[1], controller(0.9, x)[0], atol=1e-12)
    assert np.allclose(late[2], controller(99.0, x)[0], atol=1e-12)
    assert np.allclose(late[3], controller(0.5, x)[0], atol=1e-12)  # before the beginning: the first row


# Where an operation is not defined for all numbers: its arguments, from any a and b.


@needs_compiler
def test_every_operation_agrees(tmp_path):
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2)
    operations = {name: f for name, f in scalar_operations().items() if name not in NO_C}
    assert len(operations) > 45
    values = [f(x[0], x[1]) for f in operations.values()]
    constants = [ca.SX(3.5), ca.SX(0), x[0] ** 1.7, t]
    controller = law_of([*values, *constants], t, x)
    program = compiled(export_c(controller, tmp_path, dt=0.1))
    times, states = 0.1 * np.arange(60), 2 * np.random.default_rng(8).normal(size=(60, 2))
    states[-1] = 0.0
    expected = python(controller, times, states, 0.1)
    finite = np.isfinite(expected)
    assert np.all(finite[:-1, : len(values)])
    found = run(program, times, states)
    assert np.allclose(found[finite], expected[finite], rtol=1e-12, atol=1e-12)
    assert np.all(np.isnan(found[~finite]) == np.isnan(expected[~finite]))


@pytest.mark.parametrize("name", sorted(NO_C))
def test_operations_without_a_form_are_named(name):
    function = scalar_operations()[name]
    with pytest.raises(ArgumentError, match=f"operation '{name.lower()}' of function .* has no form in C"):
        write_c_statements(function, ["a", "b"], ["u"])


def test_header_names_sizes_and_units(tmp_path):
    code = export_c(holder(0.1), tmp_path)
    assert code.name == "hold___trim"
    text = code.header.read_text()
    for line in (
        "#define HOLD___TRIM_N_STATES 2",
        "#define HOLD___TRIM_N_MEMORY 5",
        "#define HOLD___TRIM_N_ROWS 1",
        "#define HOLD___TRIM_DT 0.1 /* control step, s */",
        " *   [1] v, rad/s",
        " *   [0] a, 1/s^2",
        " *   [0] integral_q, rad s",
        " *   [1] last_good_q, rad",
        " *   [2] a_ff, 1/s^2",
        "void hold___trim_step(double t, const double *x, double *z, double *u);",
    ):
        assert line in text
    assert all(ord(c) < 128 for c in text + code.source.read_text())


def test_table_ends_with_the_tail(tmp_path):
    code = export_c(follower(), tmp_path, dt=0.1, name="swing")
    assert code.rows == 32  # 30.3 steps: 31 rows of the reference and one of the tail


def test_open_loop_knows_its_span(tmp_path):
    _, reference = pendulum()
    code = export_c(go.feedforward(reference), tmp_path, dt=0.1)
    given = export_c(go.feedforward(reference), tmp_path / "given", dt=0.1, span=(0.5, 3.53))
    assert code.rows == given.rows == 32
    assert code.source.read_text() == given.source.read_text()


def test_refusals(tmp_path):
    model, _ = pendulum()
    law = follower()
    t, x, a = ca.MX.sym("t"), ca.MX.sym("x", 2), ca.MX.sym("a")
    root = ca.rootfinder("root", "newton", {"x": a, "p": x, "g": a**3 + a - x[0]})
    solving = law_of([], ca.SX.sym("t"), ca.SX.sym("x", 2))
    solving = replace(
        solving,
        commands=Layout("command", (Variable("u", 1),)),
        step=law_function(t, x, ca.MX.sym("r", 0), ca.MX.sym("z", 1), root(0, x), ca.MX(1, 1)),
    )
    with pytest.raises(ArgumentError, match="'every operation' is not made of elementary operations"):
        export_c(solving, tmp_path, dt=0.1)
    with pytest.raises(ArgumentError, match="has no own control step: give dt"):
        export_c(law, tmp_path)
    with pytest.raises(ArgumentError, match="still changes by"):
        export_c(law, tmp_path, dt=0.1, span=(0.5, 2.0))
    with pytest.raises(ArgumentError, match="cannot be the name of a C function"):
        export_c(law, tmp_path, dt=0.1, name="no name")
    with pytest.raises(ArgumentError, match="the result of a design function"):
        export_c(model, tmp_path)
    with pytest.raises(ArgumentError, match="letters of C"):
        export_c(law, tmp_path, dt=0.1, name="\u00e9tage")
    with pytest.raises(ArgumentError, match=r"span of a schedule is 3\.0: give finite times"):
        export_c(law, tmp_path, dt=0.1, span=3.0)
    with pytest.raises(ArgumentError, match="too many for a table"):
        export_c(law, tmp_path, dt=0.1, span=(0.5, 1e9))


@needs_compiler
@pytest.mark.parametrize("design", [follower, holder])
def test_nothing_undefined_and_no_foreign_memory_with_samples_of_all_kinds(tmp_path, design):
    controller = design(0.1)
    program = sanitized(export_c(controller, tmp_path))
    times = np.array([0.5, 0.6, 0.7, 1.0, 3.5, 10.5, 2.0, 2.1])
    states = np.array(
        [[0, 0], [np.nan, 0], [1e300, -1e300], [0.1, np.inf], [-0.2, 0.1], [0, 0], [1e31, 0], [0.3, -0.1]]
    )
    found = run(program, times, states)
    assert found == pytest.approx(python(controller, times, states, 0.1), rel=1e-12, abs=1e-14)


@needs_compiler
def test_options_that_know_no_nan_are_refused(tmp_path):
    code = export_c(holder(0.1), tmp_path)
    with pytest.raises(subprocess.CalledProcessError) as refused:
        compiled(code, "-O0", "-ffast-math")
    assert b"lost samples would pass" in refused.value.stderr
    compiled(code, "-O0", "-ffast-math", "-fno-finite-math-only")


def test_header_gives_operations_and_stack(tmp_path):
    """Of a law by hand: u = -(2 x0 + 3 x1) has four operations; the arrays are those declared in the source."""
    model, _ = pendulum()
    t, x, r, z = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("r", 0), ca.SX.sym("z", 0)
    none = Layout("entry")
    by_hand = Controller(
        "by hand", law_function(t, x, r, z, -(2.5 * x[0] + 3.5 * x[1]), z),
        initial_state_function(t, x, r, ca.SX(0, 1)),
        model.states, model.controls, none, none,
        lambda times, dt: np.zeros((0, times.size)), DesignReport("by hand"), 0.1,
    )  # fmt: skip
    assert "#define BY_HAND_OPERATIONS 4 " in export_c(by_hand, tmp_path).header.read_text()
    code = export_c(follower(0.1), tmp_path)
    declared = [int(n) for n in re.findall(r"double (?:w|r|z_next)\[(\d+)\];", code.source.read_text())]
    stack = int(re.search(r"TVLQR_STACK (\d+)", code.header.read_text())[1])
    assert max(declared) * 8 < stack <= sum(declared) * 8


INF = np.inf


def crane() -> Model:
    """The control acts by the cosine of the angle."""
    model = Model("crane")
    q, v, a = model.state("q"), model.state("v"), model.control("a")
    model.ode({q: v, v: a * ca.cos(q)})
    return model


def rows(change=None, states=(), errors=(), lower=(), upper=(), price=()):
    return StepLimits(
        np.array([-1.0, -2.0]), np.array([1.0, 4.0]), change, states, errors, np.array(lower),
        np.array(upper), np.array(price),
    )  # fmt: skip


def test_constants_and_texts_of_c():
    assert [DOUBLE(v) for v in (np.nan, INF, -INF, 0.1, -2)] == [
        "NAN",
        "INFINITY",
        "-INFINITY",
        "0.1",
        "-2.0",
    ]
    assert _make_c_identifier("My law 2 (x)") == "my_law_2__x"
    assert _make_c_identifier("2nd") == "law_2nd"
    assert _make_c_identifier("ä!") == "law_"
    assert _escape_c_comment("a /* b */ ä") == "a / * b * / ?" and DOUBLE.format_c_literal(0.1) == "0.1"
    assert wrap_c_initializer_lines(["1"] * 3) == "1, 1, 1"
    assert wrap_c_initializer_lines(["1"] * 40).count("\n") >= 1
    assert _write_c_comments_of_signals(Layout("s", (Variable("r", 2, "m"), Variable("n")))) == [
        "[0] r[0], m",
        "[1] r[1], m",
        "[2] n, -",
    ]
    for act in (lambda: DOUBLE.format_c_literal(INF), lambda: _read_c_identifier_prefix("a b")):
        with pytest.raises(ArgumentError):
            act()
    assert _read_c_identifier_prefix("law") == "law"


def scheduled(rows, signals=1, span=(0.0, 1.0)):
    return SimpleNamespace(name="c", signals=SimpleNamespace(size=signals), span=span, schedule=rows)


def test_the_rows_of_a_schedule_in_c():
    """From the beginning of the span in steps to its end, and the row that is good from there on."""

    def table(law, dt, span=None):
        return tabulate_references_and_gains(law, dt, span)

    found = table(scheduled(lambda t, dt: np.minimum(t, 1.0)[None, :], span=(0.5, 1.0)), 0.2)
    assert found.first == 0.5 and found.rows.ravel() == pytest.approx([0.5, 0.7, 0.9, 1.0])
    found = table(scheduled(lambda t, dt: np.minimum(t, 1.0)[None, :]), 0.25)
    assert found.rows.ravel() == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert table(scheduled(None, 0), 0.1).rows.shape == (1, 0)
    assert table(scheduled(lambda t, dt: 0 * t[None, :], span=None), 0.1, (2.0, 2.0)).rows.shape == (1, 1)
    for wrong, span, message in (
        (scheduled(lambda t, dt: t[None, :]), None, "still changes by"),
        (scheduled(lambda t, dt: 0 * t[None, :], span=None), None, "has no known end"),
        (scheduled(lambda t, dt: 0 * t[None, :]), (1.0, 0.0), "t_0 <= t_f"),
        (scheduled(lambda t, dt: 0 * t[None, :]), (0.0, INF), "finite"),
    ):
        with pytest.raises(ArgumentError, match=message):
            table(wrong, 0.1, span)


def test_a_memory_of_another_size_is_refused() -> None:
    """CasADi would take one number for all of it."""
    cart = crane()
    regulator = design_lqr(cart, [0.0, 0.0], Q=1, R=1, dt=0.1)
    with pytest.raises(ArgumentError, match="memory given to 'LQR' has 1 entries, not"):
        regulator(0.0, [1.0, 0.0], [1.0])
