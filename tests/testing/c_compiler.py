"""Controllers exported to C: compiled with all warnings as errors, run beside the Python law."""

import re
import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest

import gnc_opt as go
from gnc_opt.control import (
    Controller,
    DesignReport,
    Reference,
    design_lqr,
    design_tvlqr,
    initial_state_function,
    law_function,
)
from gnc_opt.model import Layout, Variable

COMPILER = shutil.which("cc")


FLAGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wfloat-equal", "-Werror", "-O2"]


SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]


needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) on this machine")


def pendulum() -> tuple[go.Model, Reference]:
    model = go.Model("pendulum")
    q, v = model.state("q", unit="rad"), model.state("v", unit="rad/s")
    a = model.control("a", unit="1/s^2")
    model.ode({q: v, v: a - ca.sin(q)})
    model.difference(q, lambda x, ref: 2 * ca.sin((x - ref) / 2))
    reference = Reference.from_functions(
        model, lambda t: [np.cos(t), -np.sin(t)], lambda t: [np.sin(np.cos(t)) - np.cos(t)], 0.5, 3.53
    )
    return model, reference


def follower(dt=None):
    model, reference = pendulum()
    return design_tvlqr(model, reference, Q=1, R=1, dt=dt)


def holder(dt=None):
    model, _ = pendulum()
    return design_lqr(
        model, [0.3, 0], Q=1, R=1, dt=dt, integral={"q": 0.5}, limits=(-0.5, 0.5), name="Hold & trim"
    )


def compiled(code, *more):
    program = code.header.parent / "driver"
    subprocess.run(
        [COMPILER, *FLAGS, *more, "-o", str(program), str(code.source), str(code.driver), "-lm"],
        check=True,
        capture_output=True,
    )
    return program


def sanitized(code, *more):
    """Compiled so that the address and undefined-behaviour sanitizers end the program at the first violation."""
    try:
        return compiled(code, *SANITIZERS, *more)
    except subprocess.CalledProcessError as error:
        if re.search(rb"saniti[sz]e|lib[a-z]*san|-l[a-z]*san", error.stderr):
            pytest.skip("the compiler has no sanitizers")
        raise


def run(program, times, states) -> np.ndarray:
    lines = [" ".join(repr(float(v)) for v in (t, *x)) for t, x in zip(times, states, strict=True)]
    found = subprocess.run([str(program)], input="\n".join(lines), check=True, capture_output=True, text=True)
    return np.array([[float(v) for v in line.split()] for line in found.stdout.splitlines()])


def python(controller, times, states, dt) -> np.ndarray:
    z, commands = None, []
    for t, x in zip(times, states, strict=True):
        u, z = controller(t, x, z, dt)
        commands.append(u)
    return np.array(commands)


DOMAINS = {
    "ASIN": lambda a, b: (ca.tanh(a), b),
    "ACOS": lambda a, b: (ca.tanh(a), b),
    "ATANH": lambda a, b: (ca.tanh(a), b),
    "SQRT": lambda a, b: (a**2, b),
    "LOG": lambda a, b: (a**2, b),
    "LOG1P": lambda a, b: (a**2, b),
    "ACOSH": lambda a, b: (1 + a**2, b),
    "POW": lambda a, b: (a**2, b),
    "CONSTPOW": lambda a, b: (a**2, b),
    # both ways of the condition, and equal numbers too
    **dict.fromkeys(("LT", "LE", "EQ", "NE"), lambda a, b: (ca.floor(a), ca.floor(b))),
    **dict.fromkeys(("NOT", "AND", "OR", "IF_ELSE_ZERO"), lambda a, b: (ca.floor(a), ca.floor(b))),
}


NO_C = {"ERFINV", "PRINTME"}  # not in C99; prints


def scalar_operations() -> dict[str, ca.Function]:
    """A function of (a, b) for every operation on numbers that this CasADi knows."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    operations = {}
    for name in (name[3:] for name in dir(ca) if name.startswith("OP_")):
        value = ca.SX.binary(getattr(ca, f"OP_{name}"), *DOMAINS.get(name, lambda a, b: (a, b))(a, b))
        if not value.is_constant():  # what is not an operation on numbers yields 0
            operations[name] = ca.Function(name.lower(), [a, b], [value])
    return operations


def law_of(values: list[ca.SX], t: ca.SX, x: ca.SX) -> Controller:
    """A law without a schedule, and with a memory it does not use."""
    r, z = ca.SX.sym("r", 0), ca.SX.sym("z", 1)
    u = ca.vertcat(*values)
    return Controller(
        name="every operation",
        step=law_function(t, x, r, z, u, ca.SX(1, 1)),
        start=initial_state_function(t, x, r, ca.SX(1, 1)),
        states=Layout("state", (Variable("x", 2),)),
        commands=Layout("command", (Variable("u", u.shape[0]),)),
        signals=Layout("signal"),
        memory=Layout("memory", (Variable("unused", 1),)),
        schedule=lambda times, dt: np.zeros((0, np.size(times))),
        explanation=DesignReport("every operation"),
    )
