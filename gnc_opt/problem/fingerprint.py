"""Fingerprint: a hash by which a stored solution recognises its problem."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.problem.interval import Interval
from gnc_opt.problem.statement import Statement


def problem_fingerprint(problem: Statement) -> str:
    """Return a hash of the functions, names and numbers that define the problem (hex, 16 digits)."""
    digest = hashlib.sha256()
    for leg in problem.phases.values():
        pieces = [leg.model.derivative(), leg.path_expression(), leg.integrand_expression()]
        digest.update(b"".join(map(_exact, pieces)))
        digest.update(str((leg.name, leg.model.states, leg.model.controls, leg.model.parameters)).encode())
        for vector in (
            leg.model.parameter_values,
            *_vectors(leg.numbers),
            *_vectors(leg.path_interval()),
        ):
            digest.update(vector.tobytes())
    digest.update(
        _exact(problem.cost) + _exact(problem.constraint_expression()) + str(problem.sense).encode()
    )
    for vector in (*_vectors(problem.constraint_interval()), *_vectors(problem.parameter_interval())):
        digest.update(vector.tobytes())
    return digest.hexdigest()[:16]


def _vectors(box: Any) -> Iterable[Array]:
    """Yield every float vector of a dataclass of intervals, depth first."""
    for value in vars(box).values():
        if isinstance(value, Interval):
            yield from (value.lower, value.upper)
        elif isinstance(value, np.ndarray):
            yield value


def _exact(expression: Any) -> bytes:
    """Return an expression with every digit of its constants; printed, they would be rounded to six."""
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(expression))
    return bytes(ca.Function("exact", [symbols], [expression]).serialize(), "ascii")
