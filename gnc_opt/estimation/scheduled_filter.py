r"""Extended Kalman filter with scheduled gains: made beforehand along a reference, as those of a regulator are.

Covariances of the extended filter depend on the samples by the points of linearization alone. Along a reference they
are known beforehand, and so are its gains,

.. math:: K_k = P_k^+ H_k^T R^{-1}, \qquad \hat x \leftarrow r(\hat x, K_k \, d(y, \hat y)) .

On board remain the prediction of the state by the nonlinear dynamics, the samples that it would give, and one product
with a matrix: some operations per entry of K instead of some per entry of P and sample. A sample that is missing or
refused leaves its columns out, and nothing else learns of it: the gains, and what is told of the errors, stay those of
all samples taken. For linear systems in which none is missing this is Kalman's filter.

Innovations are judged by :math:`S = H P^- H^T + R` of their own measurement. After the reference has ended, gains are
made for its tail until they are steady to a relative `STEADY`; the last are held. Of a measurement that is not due at
every step they are those of the last step at which it was.

References
----------
M. Safonov, M. Athans, Robustness and computational aspects of nonlinear stochastic estimators and regulators, IEEE
Trans. Automatic Control 23 (1978): extended filters with gains that do not depend on the data.
A. Gelb (ed.), Applied Optimal Estimation (1974), section 6.1: linearized filters along a nominal trajectory.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from gnc_opt.arrays import Array
from gnc_opt.control.control_limits import saturated
from gnc_opt.control.design_report import Explanation, Fact
from gnc_opt.control.reference import Reference, read_plant
from gnc_opt.environment import one_thread
from gnc_opt.errors import ArgumentError
from gnc_opt.estimation.design import Deviations, FilterDesign
from gnc_opt.estimation.estimator import Estimator
from gnc_opt.estimation.kalman_filter import Tally, counters
from gnc_opt.estimation.linearization import Tangent
from gnc_opt.estimation.measurement import FilterOptions, Measurement, UnscentedOptions, read_options
from gnc_opt.model.model import Model
from gnc_opt.model.variables import Layout, Variable

STEADY = 1e-5
"""Change of the gains over their period from which on they are held, by what the noise of a sample moves an error,
relative to the largest such."""

_CALM = 10
"""Periods for which they have changed no more: what swings has still times."""

_LONGEST = 1000
"""Control steps of the tail at most, for which gains are made."""

_GAIN, _TIME = "kalman_gain", "predicted_for"


@one_thread()
def design_scheduled_ekf(
    model: Model,
    reference: Reference | ArrayLike,
    measurements: Sequence[Measurement],
    *,
    sigma0: Deviations,
    dt: float,
    process_noise: Deviations | None = None,
    options: FilterOptions | None = None,
) -> Estimator:
    """Return an extended Kalman filter with gains made beforehand along a reference, for a fraction of the operations.

    It is told where the vehicle should be, not where it is: to be compared with `design_ekf` in a campaign.

    Parameters
    ----------
    model : Model
        Of the vehicle as the filter sees it.
    reference : Reference or array (n_states,)
        Along which gains are made, of the same states and controls; it begins at the first control step. A state: the
        vehicle rests there.
    measurements, sigma0, dt, process_noise, options
        As for `design_ekf`; ``options.t0`` is the reference's.

    Returns
    -------
    Estimator
        Its ``signals`` are the gains, and for each measurement the root of the inverse of its innovations' covariance.

    Raises
    ------
    ArgumentError, DesignError, UnknownNameError, ModelError
        As for `design_ekf`, or the reference is of other states or controls.

    Examples
    --------
    >>> from gnc_opt.estimation import Measurement
    >>> about = {"sigma0": {"q": 0.1, "v": 0.02}, "process_noise": {"v": 0.01}, "dt": 0.1}
    >>> light = go.design_scheduled_ekf(cart, [1.0, 0.0], [Measurement("q", 1e-3)], **about)
    >>> full = go.design_ekf(cart, [1.0, 0.0], [Measurement("q", 1e-3)], **about)
    >>> print(light(0.0, [1.05], [0.0])[0].round(6), full(0.0, [1.05], [0.0])[0].round(6))  # linear: the same
    [1.049995 0.      ] [1.049995 0.      ]
    """
    told = read_options(options, "scheduled EKF")
    if isinstance(told, UnscentedOptions):
        raise ArgumentError("design_scheduled_ekf() has no points to spread: give FilterOptions(...).")
    path = read_plant(model, reference, "design_scheduled_ekf")
    for kind, own, there in (
        ("states", model.states, path.states),
        ("controls", model.controls, path.controls),
    ):
        if own.labels != there.labels:
            raise ArgumentError(
                f"the reference of '{told.name}' has the {kind} {list(there.labels)}, the model {list(own.labels)}: "
                "give one of the same."
            )
    if told.t0 not in (0.0, path.initial_time):
        raise ArgumentError(
            f"t0 of '{told.name}' is {told.t0:g} s, its reference begins at {path.initial_time:g} s: leave t0 out."
        )
    first = path.x(path.initial_time)
    design = FilterDesign(
        model,
        first,
        measurements,
        (sigma0, process_noise),
        dt,
        replace(told, t0=path.initial_time),
    )
    full = design.estimator(Tangent(), "extended Kalman filter with scheduled gains")
    return _scheduled(design, full, _tabulated(design, full, path))


@dataclass(frozen=True, eq=False)
class KalmanSchedule:
    """Gains and covariances at control steps.

    Attributes
    ----------
    first, dt : float
        Time of the first step, and their distance, s.
    gains : array (n_steps, n_errors, n_samples)
    roots : array (n_steps, n)
        For each measurement, row by row, the lower W with W' W the inverse of the covariance of its innovations.
    predicted : array (n_steps, n_errors, n_errors)
        Covariances before the samples.
    steady : bool
        Whether the last gains are.
    """

    first: float
    dt: float
    gains: Array
    roots: Array
    predicted: Array
    steady: bool

    @property
    def pattern(self) -> Any:
        """Sparsity of all gains."""
        there = np.any(self.gains != 0, axis=0)
        return ca.sparsify(ca.DM(there.astype(float))).sparsity()

    def __call__(self, times: Array, dt: float) -> Array:
        rows, columns = (np.array(k, dtype=np.int64) for k in self.pattern.get_triplet())
        steps = self._steps(times)
        return np.vstack([self.gains[steps][:, rows, columns].T, self.roots[steps].T])

    def of(self, memory: Array, layout: Layout) -> Array:
        """Return the covariances of predictions, see `gnc_opt.estimation.estimator.Covariances`."""
        return np.asarray(self.predicted[self._steps(memory[layout.slice(_TIME)][0])])

    def _steps(self, times: Any) -> Any:
        steps = np.rint((np.asarray(times) - self.first) / self.dt)
        return np.clip(np.nan_to_num(steps), 0, len(self.gains) - 1).astype(np.int64)


def _tabulated(design: FilterDesign, full: Estimator, path: Reference) -> KalmanSchedule:
    """Return what the full filter does if the vehicle is where it should be and every sample comes."""
    augmented, sight = design.augmented, design.sight()
    states, noise = design.model.states.size, np.diag(design.sigma**2)
    sizes = [0, *np.cumsum([c.space.errors for c in augmented.channels]).tolist()]
    places = [slice(*pair) for pair in itertools.pairwise(sizes)]
    period = math.lcm(*(c.period for c in augmented.channels))
    least = math.ceil((path.final_time - design.t0) / design.dt) + period
    times = design.t0 + design.dt * np.arange(least + _LONGEST)
    xs, us = path.x(times), path.mean_control(times, design.dt)
    z, gain = full.first.copy(), np.zeros((augmented.errors.size, sizes[-1]))
    roots: list[Array] = [np.zeros(0)] * len(places)
    gains, whitenings, predicted, calm = [], [], [], 0
    for t, x, u in zip(times, xs.T, us.T, strict=True):
        z[:states] = x
        before = full.covariances.of(z, full.memory)
        y, H = (np.asarray(m.full()) for m in sight(t, z[: augmented.space.size]))
        updated = np.asarray(full.update(t, y, [], z)[1].full()[:, 0])
        after = full.covariances.of(updated, full.memory)
        gain = gain.copy()
        for k, (channel, place) in enumerate(zip(augmented.channels, places, strict=True)):
            if channel.counted and z[full.memory.slice(f"{channel.name}_next")][0] > 0.5 and roots[k].size:
                continue
            gain[:, place] = after @ H[place].T / np.diag(noise)[place]
            S = H[place] @ before @ H[place].T + noise[place, place]
            eye = np.eye(S.shape[0])
            W = scipy.linalg.solve_triangular(np.linalg.cholesky(S), eye, lower=True)
            roots[k] = W[np.tril_indices_from(W)]
        gains.append(gain)
        whitenings.append(np.concatenate(roots))
        predicted.append(before)
        if len(gains) > least:
            moved, size = (np.abs(m) * design.sigma for m in (gain - gains[-period - 1], gain))
            calm = calm + 1 if np.all(moved <= STEADY * np.max(size, axis=1, keepdims=True)) else 0
        if calm > _CALM * period:
            break
        z = np.asarray(full.predict(t, u, updated).full()[:, 0])
    return KalmanSchedule(
        design.t0,
        design.dt,
        np.stack(gains),
        np.stack(whitenings),
        np.stack(predicted),
        calm > _CALM * period,
    )


def _scheduled(design: FilterDesign, full: Estimator, table: KalmanSchedule) -> Estimator:
    """Return the filter that takes its gains from a table."""
    augmented = design.augmented
    pattern = table.pattern
    roots = [
        Variable(f"{c.name}_whitening", c.space.errors * (c.space.errors + 1) // 2)
        for c in augmented.channels
    ]
    signals = Layout("signal", (Variable(_GAIN, pattern.nnz()), *roots), f"the schedule of '{design.name}'")
    estimates = [Variable(f"{v.name}_hat", v.size, v.unit) for v in augmented.states.variables]
    memory = Layout(
        "memory",
        (*estimates, Variable(_TIME, 1, "s"), *counters(augmented.channels)),
        full.memory.owner,
    )
    first = np.zeros(memory.size)
    for name in memory.names:
        first[memory.slice(name)] = design.t0 if name == _TIME else full.first[full.memory.slice(name)]
    last = table.first + (len(table.gains) - 1) * table.dt
    state = f"steady to {STEADY:g} then" if table.steady else "not steady then; the last are held"
    *facts, hold = full.explanation.facts
    gains = Fact("gains", f"{len(table.gains)} rows until {last:g} s", remark=state)
    return replace(
        full,
        update=_update(design, memory, signals, pattern),
        predict=_predict(design, memory),
        first=first,
        covariances=table,
        memory=memory,
        signals=signals,
        schedule=table,
        span=(table.first, last),
        explanation=Explanation(full.explanation.title, (*facts, gains, hold)),
    )


def _update(design: FilterDesign, memory: Layout, signals: Layout, pattern: Any) -> Any:
    """Return ``(t, y, r, z) -> (x, z)``."""
    augmented = design.augmented
    sizes = [0, *np.cumsum([c.variable.size for c in augmented.channels]).tolist()]
    t, y, r = ca.SX.sym("t"), ca.SX.sym("y", sizes[-1]), ca.SX.sym("r", signals.size)
    z = ca.SX.sym("z", memory.size)
    x, tally, innovations = z[: augmented.space.size], Tally(memory, z), []
    for channel, sample in zip(augmented.channels, ca.vertsplit(y, sizes), strict=True):
        good = tally.good(channel, sample)
        expected = augmented.observed(channel)(t, x)
        innovation = ca.if_else(good, channel.space.difference(sample, expected), 0)
        m = channel.space.errors
        W = ca.SX(ca.Sparsity.upper(m), r[signals.slice(f"{channel.name}_whitening")]).T  # row by row
        taken = tally.take(channel, good, ca.sumsqr(W @ innovation))
        gated = channel.measurement.gate is not None
        innovations.append(ca.if_else(taken, innovation, 0) if gated else innovation)
    K = ca.SX(pattern, r[signals.slice(_GAIN)])
    x = augmented.space.retraction(x, K @ ca.vertcat(*innovations))
    told = tally.told(x[: augmented.model.states.size], design.hold)
    outputs = ca.cse([told, _column(design, memory, tally.entries, x)])
    return ca.Function("update", [t, y, r, z], outputs, ["t", "y", "r", "z"], ["x", "z_next"])


def _predict(design: FilterDesign, memory: Layout) -> Any:
    """Return ``(t, u, z) -> z``."""
    augmented = design.augmented
    t, u, z = (
        ca.SX.sym(name, n) for name, n in (("t", 1), ("u", augmented.model.controls.size), ("z", memory.size))
    )
    x, entries = z[: augmented.space.size], {name: z[memory.slice(name)] for name in memory.names}
    if augmented.remembers:
        x = augmented.shift()(t, x)
    h = augmented.dt / design.substeps
    flow = augmented.flow(h)
    for i in range(design.substeps):
        x = flow(t + i * h, x, saturated(u, design.limits))
    entries[_TIME] = t + augmented.dt
    outputs = ca.cse([_column(design, memory, entries, x)])
    return ca.Function("predict", [t, u, z], outputs, ["t", "u", "z"], ["z_next"])


def _column(design: FilterDesign, memory: Layout, entries: dict[str, Any], x: Any) -> Any:
    """Return the memory with other estimates."""
    states = design.augmented.states
    own = {f"{name}_hat": x[states.slice(name)] for name in states.names}
    return ca.vertcat(*[(entries | own)[name] for name in memory.names])
