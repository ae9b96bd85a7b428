r"""Stability margins of a linear loop at the plant input.

With :math:`L = K (s - A)^{-1} B` (s on the imaginary axis, or :math:`z = e^{j \omega dt}` on the unit circle):

* per channel i, with the others closed, :math:`1 + L_i`: gain and phase margins where :math:`L_i` crosses the
  negative real axis (also at :math:`\omega = 0` and :math:`\pi / dt`) and the unit circle; delay margin = phase
  margin / frequency;
* all channels simultaneously: the disk margin :math:`\alpha = 1 / \max_\omega \|S - \tfrac12 1\|`, S = (1 + L)^{-1}.
  All channels may simultaneously change their gains between :math:`(2 - \alpha)/(2 + \alpha)` and its inverse, or their
  phases by :math:`2 \arctan(\alpha/2)`.

Source: P. Seiler, A. Packard, P. Gahinet, Introduction to disk margins, IEEE Control Syst. 40 (2020), eqs. 9-15.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from gnc_opt.array_types import Array, Mask, find_sign_changes
from gnc_opt.control.sampled_data_discretization import convert_to_continuous_poles
from gnc_opt.numerical_tolerances import ROUNDING, SAME_TIME, TINY
from gnc_opt.threads_and_package_versions import limit_to_one_thread

_ZERO_POLE_MAX_SHARE = 1e-8
"""Poles smaller than this share of the largest (sampled: of one) define no time scale (integrators, delays)."""
_BATCH_MAX_MATRICES = 1_000_000
"""Largest number of matrices per batched linear solve."""
_OFFSET = 1e-6
"""Relative distance in frequency between a resonance and the grid points on either side."""
_GAIN_ROUNDING_SHARE = 1e-4
"""Relative change of a loop gain by rounding of A above which the gain is infinite (integrator, undamped mode)."""


@dataclass(frozen=True)
class Margins:
    """Stability margins at the plant input, one number per channel except ``disk``.

    Attributes
    ----------
    gain_up, gain_down : array (m,)
        Gain factors of the channel at which stability is lost; ``inf`` and 0 if it is never lost.
    phase : array (m,)
        Phase margin, rad; ``inf`` if the loop gain never crosses one.
    delay : array (m,)
        Delay margin, s.
    disk : float
        Disk margin alpha of all channels simultaneously; at most 2 for a strictly proper loop.
    """

    gain_up: Array
    gain_down: Array
    phase: Array
    delay: Array
    disk: float


@limit_to_one_thread()
def compute_stability_margins(a: Array, b: Array, gain: Array, dt: float | None = None) -> Margins:
    """Return the margins of the stable loop ``v = -gain e``; dt (s) for a sampled plant (A, B)."""
    omega = _build_margin_frequency_grid(a, a - b @ gain, dt)
    channels = [_compute_channel_margins(a, b, gain, i, omega, dt) for i in range(b.shape[1])]
    up, down, phase, delay = (np.array(column) for column in zip(*channels, strict=True))
    return Margins(up, down, phase, delay, _compute_disk_margin(a, b, gain, omega, dt))


def _compute_channel_margins(
    a: Array, b: Array, gain: Array, i: int, omega: Array, dt: float | None
) -> tuple[float, float, float, float]:
    """Return gain margins upwards and downwards, phase margin (rad) and delay margin (s) of one control channel."""
    others = [j for j in range(b.shape[1]) if j != i]
    dynamics = a - b[:, others] @ gain[others]
    within = mask_states_on_input_output_path(dynamics, b[:, [i]], gain[[i]])
    dynamics, b, gain = dynamics[np.ix_(within, within)], b[within], gain[:, within]

    def evaluate_loop_gain(w: float) -> complex:
        return complex(_evaluate_loop_transfer(dynamics, b[:, [i]], gain[[i]], np.array([w]), dt)[0, 0, 0])

    values = _evaluate_loop_transfer(dynamics, b[:, [i]], gain[[i]], omega, dt)[:, 0, 0]
    crossings = [
        1.0 / -v
        for v in _find_real_axis_crossings(
            (dynamics, b[:, i], gain[i]), evaluate_loop_gain, omega, values.imag, dt
        )
        if v < 0
    ]
    unit = _find_bracketed_roots(
        lambda w: np.log(abs(evaluate_loop_gain(w))), omega, np.log(np.abs(values) + TINY)
    )
    phases = [
        (
            abs(_wrap_phase_angle(np.angle(-evaluate_loop_gain(w)))),
            _compute_phase_lag(evaluate_loop_gain(w)) / w,
        )
        for w in unit
    ]
    return (
        min((c for c in crossings if c > 1), default=np.inf),
        max((c for c in crossings if c < 1), default=0.0),
        min((p for p, _ in phases), default=np.inf),
        min((d for _, d in phases), default=np.inf),
    )


def mask_states_on_input_output_path(a: Array, b: Array, c: Array) -> Mask:
    """Return which states (n,) lie on a path from the inputs to the outputs in the graph of the matrices."""
    there = a != 0

    def mask_states_reachable_from(from_: Mask, ways: Mask) -> Mask:
        while np.any(more := ways[:, from_].any(axis=1) & ~from_):
            from_ = from_ | more
        return from_

    reachable, observable = (
        mask_states_reachable_from(np.any(b != 0, axis=1), there),
        mask_states_reachable_from(np.any(c != 0, axis=0), there.T),
    )
    return np.asarray(reachable & observable)


def _compute_disk_margin(a: Array, b: Array, gain: Array, omega: Array, dt: float | None) -> float:
    one = np.eye(b.shape[1])

    def compute_sensitivity_norm(log_w: Array) -> Array:
        sensitivity = np.linalg.inv(one + _evaluate_loop_transfer(a, b, gain, np.exp(log_w), dt))
        return np.asarray(np.linalg.norm(sensitivity - 0.5 * one, 2, axis=(1, 2)))

    grid = np.log(omega)
    values = compute_sensitivity_norm(grid)
    k = int(np.argmax(values))
    best = scipy.optimize.minimize_scalar(
        lambda w: -float(compute_sensitivity_norm(np.array([w]))[0]),
        bounds=(grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]),
        method="bounded",
    )
    return 1.0 / max(float(values[k]), -float(best.fun))


def _evaluate_loop_transfer(a: Array, b: Array, gain: Array, omega: Array, dt: float | None) -> Array:
    """Return L (n_frequencies, m, m), evaluated in batches of frequencies that fit in memory."""
    one, right = np.eye(len(a)), b[None].astype(complex)
    points = np.array([_get_laplace_or_z_variable(w, dt) for w in omega])[:, None, None]
    some = max(1, _BATCH_MAX_MATRICES // max(a.size, 1))
    blocks = [points[k : k + some] for k in range(0, points.size, some)]
    return np.concatenate([gain @ np.linalg.solve(s * one - a, right) for s in blocks])


def _get_laplace_or_z_variable(omega: float, dt: float | None) -> complex:
    """Return s, or z of a sampled loop, at a frequency (rad/s)."""
    return complex(1j * omega) if dt is None else complex(np.exp(1j * omega * dt))


def _find_real_axis_crossings(
    system: tuple[Array, Array, Array],
    value: Callable[[float], complex],
    omega: Array,
    imaginary: Array,
    dt: float | None,
) -> list[float]:
    """Return the values at which L of a system (A, b, gain) crosses the real axis; inf if rounding prevents it."""
    crossings = []
    for w in (0.0, *([] if dt is None else [omega[-1]])):
        gain, change = _evaluate_loop_gain_with_rounding_error(*system, _get_laplace_or_z_variable(w, dt))
        crossings.append(gain.real if change < _GAIN_ROUNDING_SHARE * abs(gain) else np.inf)
    for k in find_sign_changes(imaginary):
        ends = [
            _evaluate_loop_gain_with_rounding_error(*system, _get_laplace_or_z_variable(w, dt))
            for w in omega[k : k + 2]
        ]
        if all(change < abs(gain.imag) for gain, change in ends):
            (w,) = _find_bracketed_roots(lambda w: value(w).imag, omega[k : k + 2], imaginary[k : k + 2])
            gain, change = _evaluate_loop_gain_with_rounding_error(*system, _get_laplace_or_z_variable(w, dt))
            crossings.append(gain.real if change < _GAIN_ROUNDING_SHARE * abs(gain) else np.inf)
    return crossings


def _evaluate_loop_gain_with_rounding_error(
    a: Array, b: Array, gain: Array, s: complex
) -> tuple[complex, float]:
    """Return L at s (or z), and its first-order change by rounding of A and of s."""
    one = np.eye(len(a))
    try:
        from_input, to_output = np.linalg.solve(s * one - a, b), np.linalg.solve((s * one - a).T, gain)
    except np.linalg.LinAlgError:
        return complex(np.inf), np.inf
    change = np.finfo(float).eps * float(np.abs(to_output) @ (np.abs(a) + abs(s) * one) @ np.abs(from_input))
    return complex(gain @ from_input), change


def _build_margin_frequency_grid(a: Array, closed: Array, dt: float | None) -> Array:
    """Return a logarithmic frequency grid (rad/s) around the poles, with grid points next to each resonance."""
    poles = np.concatenate([np.linalg.eigvals(a), np.linalg.eigvals(closed)])
    if dt is not None:
        poles = convert_to_continuous_poles(poles[np.abs(poles) > _ZERO_POLE_MAX_SHARE], dt)
    size = np.abs(poles)
    size = size[size > _ZERO_POLE_MAX_SHARE * size.max(initial=0.0)]
    if not size.size:
        size = np.array([1.0 if dt is None else np.pi / dt])
    low, high = np.log10(size.min()) - 4.0, np.log10(size.max()) + 4.0
    grid = np.logspace(low, high, 2000)
    resonances = np.abs(poles.imag)[np.abs(poles.imag) > 0]
    grid = np.unique(np.concatenate([grid, resonances * (1 - _OFFSET), resonances * (1 + _OFFSET)]))
    return grid if dt is None else np.append(grid[grid < np.pi / dt * (1 - SAME_TIME)], np.pi / dt)


def _find_bracketed_roots(function: Callable[[float], float], omega: Array, values: Array) -> list[float]:
    return [
        float(scipy.optimize.brentq(function, omega[k], omega[k + 1], xtol=TINY, rtol=ROUNDING))
        for k in find_sign_changes(values)
    ]


def _wrap_phase_angle(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def _compute_phase_lag(value: complex) -> float:
    """Return the phase lag, in (0, 2 pi], that brings L to -1."""
    lag = float(np.angle(-value) % (2 * np.pi))
    return lag if lag > 0 else 2 * np.pi
