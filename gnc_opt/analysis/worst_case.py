"""Worst case: the dispersed values within their bounds for which a measure is largest, by a global search.

Differential evolution over the compiled run, then a local search from the best point (Storn and Price, Journal of
Global Optimization 11 (1997)). A search finds bad cases; it does not prove that there is none worse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy

from gnc_opt.analysis.scenario import Scenario, normal_numbers
from gnc_opt.arguments import expect, read_integer, suggesting_keywords
from gnc_opt.arrays import Array
from gnc_opt.errors import ArgumentError
from gnc_opt.simulation.dispersions import (
    Choice,
    Dispersion,
    Normal,
    RandomDirection,
    RandomRotation,
    Uniform,
    UniformInBall,
)
from gnc_opt.simulation.run import Run
from gnc_opt.text import Printed

_FAILED = 1e150
"""Value of a failed run: worse than any successful one."""


@dataclass(frozen=True, eq=False)
class WorstCase(Printed):
    """The worst run that was found; see `worst_case`.

    Attributes
    ----------
    measure : str
    value : float
        Of the worst run; infinite if it fails.
    nominal : float
    parameters : mapping of str to array
    runs : int
    run : Run

    Examples
    --------
    >>> bounded = {"initial.q": Uniform(-0.1, 0.1)}
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=3.0, dispersions=bounded)
    >>> worst = worst_case(scenario, "max(overshoot)", generations=3)
    >>> print(worst.value > worst.nominal, worst.runs)
    True 135
    """

    measure: str
    value: float
    nominal: float
    parameters: Mapping[str, Array]
    runs: int
    run: Run = field(repr=False)

    def __str__(self) -> str:
        lines = [
            f"worst '{self.measure}' found: {self.value:.6g} (nominal {self.nominal:.6g}), {self.runs} runs"
        ]
        width = max(map(len, self.parameters))
        for name, value in self.parameters.items():
            lines.append(f"  {name:{width}}  {np.array2string(value, precision=6)}")
        return "\n".join(lines)


@suggesting_keywords
def worst_case(
    scenario: Scenario,
    measure: str,
    *,
    generations: int = 40,
) -> WorstCase:
    """Return the worst run found within the bounds of the dispersions, without noise.

    Parameters
    ----------
    scenario : Scenario
        Its dispersions are bounded (`Uniform`, truncated `Normal`); the seed is that of the search.
    measure : str
        As in `Campaign.measure`, or one of the scenario's ``measures``.
    generations : int
        Of the search, at most; each simulates 15 runs per dispersed number (at least 30).

    Raises
    ------
    ArgumentError, UnknownNameError
        Something does not fit, nothing is dispersed, or a dispersion has no bounds.

    Examples
    --------
    >>> bounded = {"initial.q": Uniform(-0.1, 0.1)}
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=3.0, dispersions=bounded)
    >>> worst = worst_case(scenario, "max(overshoot)", generations=3)
    >>> print(f"{worst.parameters['initial.q'][0]:.3f}")  # as far as it can be
    0.900
    """
    expect(scenario, Scenario, "what worst_case() got", "give a Scenario")
    scenario.require(measure)
    generations = read_integer(generations, "the number of generations of worst_case()", 1)
    dispersions = scenario.dispersions
    if not dispersions:
        raise ArgumentError("nothing is dispersed, so the nominal run is the worst: give dispersions.")
    for name, dispersion in dispersions.items():
        if not _bounded(dispersion):
            raise ArgumentError(
                f"the dispersion of '{name}' has no bounds: give Uniform(), or truncate= to Normal()."
            )
    flight = scenario.flight
    quiet = np.zeros((flight.n_steps, scenario.noise_size))
    flown = 0

    def values(P: Array) -> Array:
        nonlocal flown
        flown += P.shape[1]
        return scenario.values(measure, P, [quiet] * P.shape[1])

    def cost(cube: Array) -> Array:
        columns = np.reshape(cube, (scenario.size, -1))
        found = values(scenario.columns(normal_numbers(columns)))
        return -np.minimum(found, _FAILED)

    people = max(15, 30 // scenario.size)
    generator = np.random.default_rng(scenario.seed)
    search = scipy.optimize.differential_evolution(
        cost, [(0.0, 1.0)] * scenario.size, maxiter=generations, popsize=people, seed=generator,
        vectorized=True, updating="deferred", polish=False, init="sobol",
    )  # fmt: skip
    best = _polished(cost, search.x)
    P = scenario.columns(normal_numbers(best[:, None]))
    nominal = values(flight.nominal[:, None])[0]
    return WorstCase(
        measure,
        float(values(P)[0]),
        float(nominal),
        {name: P[flight.layout.slice(name), 0] for name in dispersions},
        flown,
        flight.run(P[:, 0], quiet),
    )


def _polished(cost: Callable[[Array], Array], start: Array) -> Array:
    """Return the end of a local search within the cube, or the start if that is no better."""
    first = float(cost(start)[0])
    if first <= -_FAILED or first == 0:
        return start
    found = scipy.optimize.minimize(
        lambda u: float(cost(u)[0]) / abs(first), start, method="L-BFGS-B", bounds=[(0.0, 1.0)] * start.size
    )
    return np.asarray(found.x) if found.fun < first / abs(first) else start


def _bounded(dispersion: Dispersion) -> bool:
    if isinstance(dispersion, Normal):
        return dispersion.truncate is not None
    if isinstance(dispersion, (RandomDirection, RandomRotation)):
        magnitude = dispersion.radius if isinstance(dispersion, RandomDirection) else dispersion.angle
        return not isinstance(magnitude, Dispersion) or _bounded(magnitude)
    return isinstance(dispersion, (Uniform, UniformInBall, Choice))
