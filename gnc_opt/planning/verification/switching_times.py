r"""Second order of switching times by integration of perturbed switches, where theory asks for simple ones.

Second-order conditions of bang-bang arcs suppose that switches are simple, distinct and inside of phases. Here every
jump of a control component is shifted by itself, also across the boundary of two phases and where several coincide, and
the trajectory is integrated with it. Along directions that keep the end conditions to first order, which regular
controls :math:`\delta u \sim q^2 B^T \Phi(t_f, t)^T e_i` help to meet, the Lagrangian

.. math:: J + \nu^T \psi + (\lambda - \Phi_x)^T \Delta x_f + \int \mu^T c + z^T x\,dt
          + \sum_k [\lambda]_k^T \Delta x(t_k)

must not fall at second order. Its values at two steps tell a fall of second order from rounding and from one of other
orders. Shifts are measured by :math:`1/\sqrt{L_{kk}}`, lest a steep one hides a flat one.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from gnc_opt.arrays import Array
from gnc_opt.model.evaluation import evaluate_columns
from gnc_opt.planning.optimality.reach import cells_of, exponentials
from gnc_opt.planning.optimality.reference_scales import Scales
from gnc_opt.planning.problem.functions import EndGradients, end_values
from gnc_opt.planning.solution.samples import PhaseSamples
from gnc_opt.planning.solution.solution import Solution
from gnc_opt.planning.solution.verdict import Condition, ConditionResult
from gnc_opt.planning.verification.bang_bang_second_order import obstacle
from gnc_opt.tolerances import AT_LIMIT, RANK, SAME_TIME, TINY

MOST_TOGETHER = 8
"""Jumps whose shifts are combined, at most."""

SHIFT_STEP_SHARE = 0.02
"""Larger one of the two steps, in shares of the shorter arc beside a jump."""

VISIBLE = 1e-3
"""Least jump of a control, in shares of its largest change."""

STEPS_PER_CELL = 2
"""Runge-Kutta steps of fourth order per cell of the mesh."""

LEAST_GAIN_SHARE, LEAST_CURVATURE_SHARE = 1e-7, 1e-3
"""Least gain at the smaller step, in shares of the cost scale, and of the curvatures of the single shifts."""

SECOND_ORDER = (0.1, 0.6)
"""Ratios of the gains at both steps, one the half of the other, that are those of second order."""

ACTIVE_LIMIT_TIMES = 24
"""Times of a phase, at most, at which limits that act along arcs are kept."""

LIMIT_SHARE = 1e-6
"""Effect of a limit on the cost, in shares of its scale, below which its multiplier is rounding."""

KEPT = 1e-2
"""Miss of the end conditions, in shares of those of the single shifts, that is of second order."""


@dataclass(frozen=True)
class Jump:
    """A jump of a control component.

    Attributes
    ----------
    phase : str
    time : float
    channel : int
    shorter_arc : float
        Duration of the shorter of the two arcs that it separates, s.
    beyond : str
        The phase after it, of a jump at a boundary of phases; else empty.
    """

    phase: str
    time: float
    channel: int
    shorter_arc: float
    beyond: str = ""


_MEANING = (
    "Shifts of switching times that keep the end conditions must not lower the cost to second order (value: fall at "
    "the named shifts, in shares of the cost scale): a cheaper trajectory has its switches there."
)


@dataclass(frozen=True)
class Fall:
    """A direction in which the cost falls: gain at the larger step, in shares of the cost scale, and its place."""

    value: float
    where: str


def switching_times(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales
) -> Condition:
    """No shift of switching times lowers the cost to second order."""
    jumps = jumps_of(samples) if all(s.has_length for s in samples) else []
    if _are_unknowns(jumps, samples, scales):
        jumps = []
    fall = worst_fall(solution, samples, ends, scales, jumps)
    value, place = (
        (0.0, f"{len(jumps)} switches" if jumps else "no switch")
        if fall is None
        else (fall.value, fall.where)
    )
    result = ConditionResult.PASS if fall is None else ConditionResult.FAIL
    return Condition("switching times", result, value, 0.0, place, _MEANING, sufficient=True)


def _are_unknowns(jumps: list[Jump], samples: list[PhaseSamples], scales: Scales) -> bool:
    """Whether the second order has every jump as an unknown of its own: bang-bang arcs, or boundaries of a movable mesh
    at which one control jumps and no limit of the states acts."""
    if any(jump.beyond for jump in jumps):
        return False
    if not obstacle(samples):
        return True
    times = [(jump.phase, jump.time) for jump in jumps]
    limited = any(_is_limited(s, scales) for s in samples)
    movable = all(s.leg.mesh.movable for s in samples)
    return movable and not limited and len(set(times)) == len(times)


def _is_limited(s: PhaseSamples, scales: Scales) -> bool:
    """Whether a limit of states is reached inside the phase, or another path constraint acts for more than rounding."""
    reach, pure = scales.phases[s.leg.name].along.radius, np.zeros(len(s.leg.path_labels), dtype=bool)
    pure[s.pure_paths] = True
    paths = s.functions.paths(s.times, s.x, s.u)
    at_states = np.logical_or(*s.leg.state_bounds.near(s.x, AT_LIMIT * reach))
    at_paths = np.logical_or(*s.leg.path_bounds.near(paths, AT_LIMIT * s.path_scale))[pure]
    if np.any(at_states[:, 1:-1]) or np.any(at_paths[:, 1:-1]):
        return True
    pushes = np.max(np.abs(s.mu[~pure]), axis=1, initial=0.0) * s.path_scale[~pure]
    return bool(np.max(pushes, initial=0.0) * s.span > LIMIT_SHARE * scales.cost)


def worst_fall(
    solution: Solution, samples: list[PhaseSamples], ends: EndGradients, scales: Scales, jumps: list[Jump]
) -> Fall | None:
    """Return the direction of switching times in which the Lagrangian falls most, or None."""
    found = []
    for group in _groups(jumps):
        fall = _ShiftedTrajectory.of(solution, samples, ends, scales, group).fall()
        if fall is not None:
            found.append(fall)
    return max(found, key=lambda f: f.value, default=None)


def jumps_of(samples: list[PhaseSamples]) -> list[Jump]:
    """Return the jumps of the applied controls inside phases and between phases that follow each other."""
    jumps = []
    order = sorted(samples, key=lambda s: s.leg.initial_time)
    for s in order:
        leg, change = s.leg, np.ptp(s.u, axis=1)
        inner = leg.breaks[1:-1]
        if inner.size:
            size = np.abs(leg.flown(inner) - leg.flown(inner, "left"))
            for i, k in np.argwhere(size > VISIBLE * np.maximum(change, TINY)[:, None]):
                if not _is_held(s, int(i), float(inner[k])):
                    jumps.append((s, float(inner[k]), int(i), ""))
    for s, following in itertools.pairwise(order):
        a, b = s.leg, following.leg
        if abs(a.final_time - b.initial_time) > SAME_TIME * s.span or a.controls.labels != b.controls.labels:
            continue
        before, after = a.flown(a.breaks[-1], "left"), b.flown(b.breaks[0])
        change = np.maximum(np.ptp(s.u, axis=1), np.ptp(following.u, axis=1))
        size = np.abs(after - before)
        for i in np.flatnonzero(size > VISIBLE * np.maximum(change, size)):
            straight = not (_is_held(s, int(i), a.breaks[-1]) or _is_held(following, int(i), b.breaks[0]))
            on_bounds = all(_on_bound(p, v, int(i)) for p, v in ((s, before), (following, after)))
            if straight and on_bounds:
                jumps.append((s, float(a.breaks[-1]), int(i), b.name))
    ends = {s.leg.name: (s.leg.initial_time, s.leg.final_time) for s in samples}
    return [
        Jump(s.leg.name, t, i, _shorter_arc(jumps, ends, s, t, i, beyond), beyond)
        for s, t, i, beyond in jumps
    ]


def _shorter_arc(
    jumps: list[Any], ends: Any, s: PhaseSamples, time: float, channel: int, beyond: str
) -> float:
    first, last = ends[s.leg.name]
    last = ends[beyond][1] if beyond else last
    others = [t for _, t, i, _ in jumps if i == channel and t != time]
    return float(min(abs(time - t) for t in [first, last, *others] if t != time))


def _on_bound(s: PhaseSamples, u: Array, i: int) -> bool:
    scale = max(float(np.ptp(s.u[i])), abs(float(u[i])), TINY)
    bounds = s.leg.control_bounds
    return bool(min(abs(u[i] - bounds.lower[i]), abs(bounds.upper[i] - u[i])) <= AT_LIMIT * scale)


def _is_held(s: PhaseSamples, i: int, time: float) -> bool:
    """Whether an active path constraint, or one of the states, holds a control beside a time."""
    beside = int(np.argmin(np.abs(s.times - time)))
    at = np.unique(np.clip([beside - 3, beside + 3], 0, s.times.size - 1))
    u = s.u[:, at]
    lower, upper = s.leg.control_bounds.near(u, AT_LIMIT * np.max(np.abs(s.u), axis=1, initial=0.0))
    between = ~(lower | upper)[i]
    if np.any(between & (np.any(s.state_multiplier[:, at] != 0, axis=0) | np.any(s.mu[:, at] != 0, axis=0))):
        return True
    if not s.leg.path_labels:
        return False
    jacobian = s.functions.path_control_jacobian(s.times[at], s.x[:, at], u)[:, i]
    return bool(np.any((jacobian != 0) & (np.abs(s.mu[:, at]) > 0)))


def _groups(jumps: list[Jump]) -> list[list[Jump]]:
    """Return all jumps together if they are few, else those that coincide, and the others one by one."""
    if len(jumps) <= MOST_TOGETHER:
        return [jumps] if jumps else []
    found: list[list[Jump]] = []
    for jump in sorted(jumps, key=lambda j: j.time):
        near = found and abs(found[-1][0].time - jump.time) <= SAME_TIME * max(abs(jump.time), 1.0)
        if near and len(found[-1]) < MOST_TOGETHER:
            found[-1].append(jump)
        else:
            found.append([jump])
    return found


@dataclass(frozen=True, eq=False)
class _ShiftedTrajectory:
    """The trajectory as a function of shifts of jumps and of amounts of regular control variations.

    Attributes
    ----------
    jumps : list of Jump
    regular : list of (phase, times, array (m, n_times))
        Control variations.
    """

    solution: Solution
    samples: list[PhaseSamples]
    ends: EndGradients
    scales: Scales
    jumps: list[Jump]
    regular: list[tuple[str, Array, Array]]

    @classmethod
    def of(
        cls,
        solution: Solution,
        samples: list[PhaseSamples],
        ends: EndGradients,
        scales: Scales,
        jumps: list[Jump],
    ) -> _ShiftedTrajectory:
        regular = [v for s in samples for v in _regular_variations(s, scales)]
        order = sorted(samples, key=lambda s: s.leg.initial_time)
        return cls(solution, order, ends, scales, jumps, regular)

    def fall(self) -> Fall | None:
        """Return the direction in which the Lagrangian falls most, if it does so at second order."""
        n, m = len(self.jumps), len(self.regular)
        unit = np.eye(n + m)
        values, misses = self.integrate(np.concatenate([unit, -unit]).T)
        if not np.all(np.isfinite(values)):
            return None
        slopes = 0.5 * (misses[:, : n + m] - misses[:, n + m :])
        shifts, corrections = slopes[:, :n], slopes[:, n:]
        inverse = np.linalg.pinv(corrections, rcond=1e-6) if m else np.zeros((0, slopes.shape[0]))
        rest = shifts - corrections @ (inverse @ shifts)
        size = np.linalg.norm(shifts, axis=0)
        free = _null_space(rest, max(KEPT * float(np.max(size, initial=0.0)), RANK))
        if not free.shape[1]:
            return None
        full = np.vstack([free, -inverse @ shifts @ free])  # (n + m, d)
        d = full.shape[1]
        pairs = [_unit(d, i) for i in range(d)] + [
            _unit(d, i) + _unit(d, j) for i, j in itertools.combinations(range(d), 2)
        ]
        both = np.array([*pairs, *(-p for p in pairs)]).T
        values, _ = self.integrate(full @ both)
        half = 0.5 * (values[: len(pairs)] + values[len(pairs) :])
        hessian = np.diag(2 * half[:d])
        for k, (i, j) in enumerate(itertools.combinations(range(d), 2)):
            hessian[i, j] = hessian[j, i] = half[d + k] - half[i] - half[j]
        single = np.abs(np.diag(hessian))
        least = 1e-3 * np.max(single, initial=0.0)
        scale = 1 / np.sqrt(np.maximum(single, max(float(least), TINY)))
        scale = scale / np.max(scale) if np.max(single) > 0 else np.ones(d)
        directions = [_unit(d, i) for i in range(d)]
        directions += [
            _unit(d, i) + s * _unit(d, j) for i, j in itertools.combinations(range(d), 2) for s in (1, -1)
        ]
        if d > 1:
            vector = np.linalg.eigh(hessian * scale * scale[:, None])[1][:, 0]
            directions.append(vector / np.max(np.abs(vector)))
        chosen = scale[:, None] * np.array([*directions, *(-v for v in directions)]).T
        return self._second_order_fall(full @ chosen, single @ chosen**2)

    def _second_order_fall(self, directions: Array, terms: Array) -> Fall | None:
        """Return the largest fall along directions (n_jumps + n_regular, n), if it is of second order at two steps.

        ``terms`` (n,) are the sums of the curvatures of the single shifts.
        """
        n = len(self.jumps)
        largest = np.max(np.abs(directions[:n]), axis=0)
        directions = directions / np.maximum(largest, TINY)
        terms = terms / np.maximum(largest, TINY) ** 2
        count = directions.shape[1]
        values, misses = self.integrate(np.hstack([directions, 0.5 * directions]))
        gains, ratio = -values, np.zeros(count)
        coarse, fine = gains[:count], gains[count:]
        np.divide(fine, coarse, out=ratio, where=coarse > 0)
        sizes = np.linalg.norm(misses, axis=0)
        kept = sizes[count:] <= 0.35 * sizes[:count] + 1e-9
        falls = (ratio >= SECOND_ORDER[0]) & (ratio <= SECOND_ORDER[1]) & kept
        falls &= (fine > LEAST_GAIN_SHARE * self.scales.cost) & (fine > LEAST_CURVATURE_SHARE * 0.25 * terms)
        if not np.any(falls):
            return None
        best = int(np.argmax(np.where(falls, coarse, 0.0)))
        moved = np.argsort(-np.abs(directions[:n, best]))[:2]
        named = [
            f"{self._labels(self.jumps[k])} at t = {self.jumps[k].time:.6g} s by "
            f"{directions[k, best] * SHIFT_STEP_SHARE * self.jumps[k].shorter_arc:+.2g} s"
            for k in moved
            if abs(directions[k, best]) > 1e-3
        ]
        return Fall(float(coarse[best]) / self.scales.cost, "switch of " + ", ".join(named))

    def _labels(self, jump: Jump) -> str:
        leg = self.solution.phases[jump.phase]
        return f"phase {jump.phase}, {leg.controls.labels[jump.channel]}"

    def integrate(self, amounts: Array) -> tuple[Array, Array]:
        """Return changes of the Lagrangian (n_columns,) and of active end conditions (rows, n_columns).

        Parameters
        ----------
        amounts : array (n_jumps + n_regular, n_columns)
            Shifts in steps, then amounts of the regular variations.
        """
        count = amounts.shape[1] + 1
        amounts = np.hstack(
            [amounts, np.zeros((amounts.shape[0], 1))]
        )  # the trajectory itself, by the same steps
        arguments: list[Array] = []
        lagrangian, rows = np.zeros(count), []
        finals: dict[str, Array] = {}
        position = {s.leg.name: k for k, s in enumerate(self.samples)}
        found: dict[str, list[Any]] = {}
        for s in self.samples:
            leg, name = s.leg, s.leg.name
            begin = np.repeat(leg.x(leg.breaks[0])[:, None], count, axis=1)
            for other, by_end in self.scales.links.get(name, {}).items():
                if other in finals and position[other] < position[name]:
                    begin = begin + by_end @ (finals[other] - finals[other][:, -1:])
            x, integrals, extra, active_rows = self._phase(s, begin, amounts)
            rows += active_rows
            finals[name] = x
            lagrangian += extra
            found[name] = [begin, x, leg.initial_time, leg.final_time, integrals, leg.parameters]
            gap = s.lam[:, -1] - self.ends.final_state[name]
            moved = x - x[:, -1:]
            lagrangian += gap @ moved
            box = leg.final_bounds
            radius = self.scales.phases[name].end.radius
            at_limit = box.near(leg.x(leg.breaks[-1], "left"), AT_LIMIT * radius)
            held = box.fixed | at_limit[0] | at_limit[1]
            rows.append(moved[held] / np.where(radius[held] > 0, radius[held], 1.0)[:, None])
        for name in self.solution.phases:
            arguments += [v if np.ndim(v) == 2 else np.reshape(v, (np.size(v), 1)) for v in found[name]]
        columns = [np.broadcast_to(a, (a.shape[0], count)) if a.shape[1] == 1 else a for a in arguments]
        problem = self.solution.need_problem("verify")
        q = np.repeat(self.solution.parameter_values[:, None], count, axis=1)
        nu = np.zeros(self.solution.constraint_multipliers.size)
        values = evaluate_columns(end_values(problem), count, *columns, q, nu)
        psi, cost = values[:-1], problem.sense * values[-1]
        lagrangian += cost + self.solution.constraint_multipliers @ psi
        reach = self.scales.constraints[0]
        box = problem.constraint_interval()
        at = box.near(psi[:, -1], AT_LIMIT * np.maximum(reach, TINY))
        active = (at[0] | at[1]) & (reach > 0)
        rows.append((psi[active] - psi[active, -1:]) / reach[active, None])
        misses = np.vstack(rows)
        return (lagrangian - lagrangian[-1])[:-1], misses[:, :-1]

    def _phase(self, s: PhaseSamples, x: Array, amounts: Array) -> tuple[Array, Array, Array, list[Array]]:
        """Return final states, integrals, what active limits add to the Lagrangian, and their misses."""
        leg, name = s.leg, s.leg.name
        own = [k for k, j in enumerate(self.jumps) if name in (j.phase, j.beyond)]
        step = {k: SHIFT_STEP_SHARE * self.jumps[k].shorter_arc for k in own}
        # Outside of windows around the jumps all columns share their times.
        windows = [(self.jumps[k].time - 1.001 * step[k], self.jumps[k].time + 1.001 * step[k]) for k in own]
        base = cells_of(leg.breaks)
        inside = np.zeros(base.size, dtype=bool)
        for a, b in windows:
            inside |= (base > a) & (base < b)
        edges = np.concatenate([base[~inside], *[np.clip(w, base[0], base[-1]) for w in windows]])
        edges = np.unique(edges)
        count = amounts.shape[1]
        moving = [self.jumps[k].time + step[k] * amounts[k] for k in own]
        fixed = [np.full(count, self.jumps[k].time) for k in own]
        nodes = (
            np.vstack([np.repeat(edges[:, None], count, axis=1), *moving, *fixed])
            if own
            else np.repeat(edges[:, None], count, axis=1)
        )
        nodes = np.sort(np.clip(nodes, base[0], base[-1]), axis=0)
        integrals = np.zeros((leg.integrals.size, count))
        extra = np.zeros(count)
        sides = {k: (self._side(self.jumps[k], "left"), self._side(self.jumps[k], "right")) for k in own}
        variations = [(k, v) for k, v in enumerate(self.regular) if v[0] == name]
        functions = s.functions
        limits = bool(np.any(s.mu)) or bool(np.any(s.state_multiplier))
        jumps_of_costates = (
            leg.lam(leg.breaks[1:-1], "left") - leg.lam(leg.breaks[1:-1], "right")
            if leg.breaks.size > 2
            else np.zeros((x.shape[0], 0))
        )
        marked = {
            float(t): jumps_of_costates[:, k]
            for k, t in enumerate(leg.breaks[1:-1])
            if np.any(jumps_of_costates[:, k])
        }

        common = np.array(
            [bool(np.all(a == a[0]) and np.all(b == b[0])) for a, b in itertools.pairwise(nodes)]
        )
        places = np.stack([nodes[:-1, 0], 0.5 * (nodes[:-1, 0] + nodes[1:, 0]), nodes[1:, 0]], axis=1)[common]
        applied = _applied(leg, places.ravel(), np.repeat(places[:, 1], 3)).reshape(-1, *places.shape)
        index = np.cumsum(common) - 1

        def controls(step_index: int, a: Array, middle: Array, b: Array) -> list[Array]:
            """Return the controls at the start, the middle and the end of a step, (m, n_columns) each."""
            found = []
            for k, t in enumerate((a, middle, b)):
                if common[step_index]:
                    u = np.repeat(applied[:, index[step_index], [k]], count, axis=1)
                else:
                    u = _applied(leg, t, middle)
                for j in own:
                    jump, shifted = self.jumps[j], self.jumps[j].time + step[j] * amounts[j]
                    late = (middle > jump.time) & (middle < shifted)
                    early = (middle < jump.time) & (middle > shifted)
                    u[jump.channel, late] = sides[j][0]
                    u[jump.channel, early] = sides[j][1]
                for j, (_, times, shape) in variations:
                    amount = amounts[len(self.jumps) + j]
                    if np.any(amount):
                        u = u + amount * np.stack([np.interp(t, times, row) for row in shape])
                found.append(u)
            return found

        def rate(t: Array, y: Array, u: Array) -> Array:
            states = y[: x.shape[0]]
            parts = [functions.rates(t, states, u)]
            if leg.integrals.size:
                parts.append(functions.integrands(t, states, u))
            more = np.zeros(count)
            if limits:
                if len(leg.path_labels):
                    more = np.sum(leg.path_multiplier(t) * functions.paths(t, states, u), axis=0)
                more = more + np.sum(leg.state_multiplier(t) * states, axis=0)
            return np.concatenate([*parts, more[None]])

        y = np.concatenate([x, integrals, np.zeros((1, count))])
        active_limits, rows = _active_limits(s, edges), []
        for k, (a, b) in enumerate(itertools.pairwise(nodes)):
            h, middle = b - a, 0.5 * (a + b)
            if not np.any(h):
                continue
            u0, u1, u2 = controls(k, a, middle, b)
            k1 = rate(a, y, u0)
            k2 = rate(middle, y + 0.5 * h * k1, u1)
            k3 = rate(middle, y + 0.5 * h * k2, u1)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(b, y + h * k3, u2))
            if np.any(b != b[0]):
                continue
            time, moved = float(b[0]), y[: x.shape[0]] - y[: x.shape[0], -1:]
            if time in marked:
                extra += marked[time] @ moved
                rows.append(marked[time] @ moved / self.scales.cost)
            if time in active_limits:
                rows += [gradient @ moved for gradient in active_limits[time]]
        return y[: x.shape[0]], y[x.shape[0] : -1], extra + y[-1], [row[None] for row in rows]

    def _side(self, jump: Jump, side: Any) -> float:
        leg = self.solution.phases[jump.phase]
        if side == "right" and jump.beyond:
            other = self.solution.phases[jump.beyond]
            return float(other.flown(other.breaks[0])[jump.channel])
        return float(leg.flown(jump.time, side)[jump.channel])


def _applied(leg: Any, t: Array, middle: Array) -> Array:
    """Return the applied controls (m, n_times) at times of steps with given middles."""
    edge = 1e-9 * (leg.breaks[-1] - leg.breaks[0])
    inside = np.where(t < middle, t + edge, np.where(t > middle, t - edge, t))
    return np.array(leg.flown(np.clip(inside, leg.breaks[0], leg.breaks[-1])))


def _regular_variations(s: PhaseSamples, scales: Scales) -> list[tuple[str, Array, Array]]:
    """Return variations of controls between their limits that move the end of a phase in each of its directions."""
    leg, own = s.leg, scales.phases[s.leg.name]
    edges = cells_of(leg.breaks)
    times, widths = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    x, u = leg.x(times), leg.flown(times)
    by_state = np.moveaxis(np.nan_to_num(s.functions.state_jacobian(times, x, u)), 2, 0)
    by_control = np.moveaxis(np.nan_to_num(s.functions.input_jacobian(times, x, u)), 2, 0)
    deviation = np.stack([np.interp(times, s.times, row) for row in own.deviation]) if u.shape[0] else u
    most = np.max(own.deviation, axis=1, initial=0.0)
    lower, upper = leg.control_bounds.near(u, 1e-2 * most)
    inside = ~(lower | upper)
    if leg.path_labels:
        jacobian = s.functions.path_control_jacobian(times, x, u)
        active = np.abs(leg.path_multiplier(times)) > 0
        inside &= ~np.any((jacobian != 0) & active[:, None], axis=0)
    if not np.any(inside):
        return []
    halves = exponentials(0.5 * widths[:, None, None] * by_state)
    onwards = np.eye(x.shape[0])
    shapes = np.zeros((x.shape[0], *u.shape))
    for k in reversed(range(widths.size)):
        half = halves[k]
        onwards = onwards @ half
        response = onwards @ by_control[k]
        shapes[:, :, k] = response * (deviation[:, k] ** 2 * inside[:, k])
        onwards = onwards @ half
    found = []
    for shape in shapes:
        largest = np.max(np.abs(shape) / np.maximum(most, TINY)[:, None])
        if np.isfinite(largest) and largest > 0:
            found.append((leg.name, times, SHIFT_STEP_SHARE * shape / largest))
    return found


def _active_limits(s: PhaseSamples, edges: Array) -> dict[float, list[Array]]:
    """Return gradients (n,) of the limits that act along arcs, at some edges of cells, by what they change the cost."""
    leg, found = s.leg, {}
    chosen = edges[1:-1]
    if not chosen.size:
        return {}
    chosen = chosen[:: max(1, chosen.size // ACTIVE_LIMIT_TIMES)]
    states, paths = leg.state_multiplier(chosen), leg.path_multiplier(chosen)
    x, u = leg.x(chosen), leg.flown(chosen)
    by_state = (
        s.functions.path_state_jacobian(chosen, x, u) if len(leg.path_labels) else np.zeros((0, *x.shape))
    )
    lasts = leg.breaks[-1] - leg.breaks[0]
    for k, time in enumerate(chosen):
        rows = [lasts * m * row for m, row in zip(states[:, k], np.eye(x.shape[0]), strict=True) if m]
        rows += [lasts * m * row for m, row in zip(paths[:, k], by_state[:, :, k], strict=True) if m]
        if rows:
            found[float(time)] = [row / max(s.cost_scale, TINY) for row in rows]
    return found


def _null_space(rows: Array, least: float) -> Array:
    """Return an orthonormal basis (n, d) of the directions that change rows by less than a share."""
    if not rows.shape[0]:
        return np.eye(rows.shape[1])
    _, sizes, basis = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.sum(sizes > max(least, TINY)))
    return np.asarray(basis[rank:].T)


def _unit(n: int, i: int) -> Array:
    return np.asarray(np.eye(n)[i])
