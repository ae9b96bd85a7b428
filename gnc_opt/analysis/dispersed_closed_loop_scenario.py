"""Scenario: a closed loop, its initial state, time span and dispersions, and the measures of its runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import StrictAttributes, read_integer, require_type
from gnc_opt.array_types import Array
from gnc_opt.errors import GncOptError
from gnc_opt.simulation.campaign_batches_and_checkpoints import RunBatch, merge_run_batches
from gnc_opt.simulation.campaign_results import Campaign
from gnc_opt.simulation.closed_loop import ClosedLoop
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.dispersions import Dispersions, check_dispersions
from gnc_opt.simulation.monte_carlo import MeasureFunction, SuccessCriteria, read_success_criteria
from gnc_opt.simulation.simulation_run_outcome import RunStatus
from gnc_opt.workers import SharedObject, WorkerPool

_COMPLETED = (RunStatus.OK, RunStatus.INTEGRATION_ERROR)
"""Statuses of runs that have not failed."""


@dataclass(frozen=True, eq=False)
class Scenario(StrictAttributes):
    """Closed loop with initial state, time span, dispersions and measures.

    Parameters
    ----------
    loop, x0, tf, t0, dispersions, parameters, target, measures
        As in `monte_carlo`.
    seed : int

    Raises
    ------
    ArgumentError, UnknownNameError
        Inconsistent arguments; the message names the cause.

    Examples
    --------
    >>> scenario = go.Scenario(loop, x0=[1.0, 0.0], tf=8.0, dispersions=spread)
    >>> print(tuple(scenario.dispersions), scenario.noise_size)  # random numbers of a control step
    ('initial.q', 'initial.v') 1
    """

    loop: ClosedLoop
    x0: ArrayLike | Mapping[str, ArrayLike] = field(kw_only=True)
    tf: float = field(kw_only=True)
    t0: float = field(default=0.0, kw_only=True)
    dispersions: Dispersions = field(default_factory=dict, kw_only=True)
    parameters: Mapping[str, ArrayLike] | None = field(default=None, kw_only=True)
    target: Mapping[str, ArrayLike] | None = field(default=None, kw_only=True)
    measures: Mapping[str, MeasureFunction] | None = field(default=None, kw_only=True)
    seed: int = field(default=0, kw_only=True)

    def __post_init__(self) -> None:
        require_type(self.loop, ClosedLoop, "the loop of a scenario", "give a ClosedLoop")
        set_ = object.__setattr__
        set_(self, "seed", read_integer(self.seed, "the seed of a scenario", 0))
        check_dispersions(self.dispersions, self.compiled_loop.layout, self.compiled_loop.nominal)
        set_(self, "dispersions", dict(self.dispersions))
        self.success_criteria.read_target_states(self.compiled_loop)

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value for name, value in vars(self).items() if name != "loop"
        }  # the compiled loop suffices

    @cached_property
    def compiled_loop(self) -> CompiledLoop:
        """Compiled loop."""
        return self.loop.compile(self.x0, t0=self.t0, tf=self.tf, parameters=self.parameters)

    @cached_property
    def success_criteria(self) -> SuccessCriteria:
        """Targets of the runs, and user-defined measures."""
        return read_success_criteria(self.target, self.measures)

    def check_performance_measure_name(self, measure: str) -> None:
        """Raise an error if the name is not a measure of the runs."""
        if measure not in self.success_criteria.measures:
            self.simulate_campaign(np.empty((self.compiled_loop.layout.size, 0)), []).measure(measure)

    @property
    def noise_size(self) -> int:
        """Number of standard normal random numbers per control step."""
        return int(self.compiled_loop.kernel.known.size - 1 - self.compiled_loop.schedule.shape[0])

    # --- runs ---------------------------------------------------------------------------------------------

    def simulate_campaign(self, P: Array, seeds: Sequence[Any]) -> Campaign:
        """Simulate runs with parameter columns P (n_parameters, n) and seeds, and return them as a campaign."""
        runs = range(P.shape[1])
        batches = [RunBatch(runs, P, self.compiled_loop.final_values(P, seeds))] if runs else []
        goal = self.success_criteria.read_target_states(self.compiled_loop)
        campaign = merge_run_batches(self.compiled_loop, batches, seed=0, n_runs=len(runs), goal=goal)
        return self.success_criteria.apply_success_criteria(campaign) if runs else campaign

    def compute_performance_measure(self, measure: str, P: Array, seeds: Sequence[Any]) -> Array:
        """Return a measure of runs, (n,), as in `simulate_campaign`; infinite for failed runs or without a value."""
        campaign = self.simulate_campaign(P, seeds)
        completed = np.array([outcome.status in _COMPLETED for outcome in campaign.outcomes], dtype=bool)
        values = campaign.measure(measure)
        return np.where(completed & ~np.isnan(values), values, np.inf)


def run_tasks_in_workers(
    work: Any,
    method: Callable[[Any, Any], Any],
    tasks: Sequence[Any],
    executor: Executor | Literal["serial"] | None,
    name: str,
) -> list[Any]:
    """Return the results of a method of ``work`` for all tasks; raise `GncOptError` if one has no result."""
    remedy = 'define measures= functions at the top of a module, or use executor="serial"'
    with WorkerPool(SharedObject.wrap_picklable_object(work, name, remedy), executor, name) as pool:
        done = pool.map(method, tasks, lambda _: None)
    errors = [each.error for each in done if each.answer is None]
    if errors or len(done) < len(tasks):
        raise GncOptError(
            f"{name} could not simulate all its runs: {errors[0] if errors else 'it was interrupted'}."
        )
    return [each.answer for each in done]
