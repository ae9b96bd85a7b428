"""Monte Carlo simulation of a closed loop with random parameters, initial states and noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from gnc_opt.argument_checks import (
    read_integer,
    read_optional_mapping,
    read_positive_number,
    require_type,
    suggest_keywords,
)
from gnc_opt.array_types import Array
from gnc_opt.errors import ArgumentError, GncOptError, format_exception
from gnc_opt.model.model_variables import read_vector
from gnc_opt.simulation.campaign_batches_and_checkpoints import (
    Batch,
    CampaignTask,
    RunBatch,
    find_unsimulated_batches,
    get_run_batch_results,
    halve_run_batch,
    load_stored_runs,
    merge_run_batches,
    store_run_batch_file,
)
from gnc_opt.simulation.campaign_results import Campaign
from gnc_opt.simulation.campaign_scenario_description import describe_campaign_scenario
from gnc_opt.simulation.closed_loop import ClosedLoop
from gnc_opt.simulation.compiled_closed_loop import CompiledLoop
from gnc_opt.simulation.dispersions import Dispersions, check_dispersions
from gnc_opt.workers import SharedObject, TaskResult, WorkerPool

MeasureFunction = Callable[[Campaign], ArrayLike]
"""A user-defined measure: returns a number per run, (m,)."""


@dataclass(frozen=True)
class SuccessCriteria:
    """Target, limits and user-defined measures; see `monte_carlo`."""

    target: Mapping[str, ArrayLike] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    measures: Mapping[str, MeasureFunction] = field(default_factory=dict)

    def read_target_states(self, loop: CompiledLoop) -> Array:
        """Return the target final states (n_states,); NaN without a target."""
        goal = np.full(loop.states.size, np.nan)
        if loop.reference is not None:
            for name in loop.followed.names:
                if name in loop.states:
                    goal[loop.states.slice(name)] = loop.reference[loop.followed.slice(name), -1]
        for name, value in self.target.items():
            place = loop.states.slice(name)
            numbers = read_vector(value, loop.states[name].size, f"the target of '{name}'", ArgumentError)
            if not np.all(np.isfinite(numbers)):
                raise ArgumentError(
                    f"the target of '{name}' is {numbers}: give finite numbers, or leave it out."
                )
            goal[place] = numbers
        return goal

    def check_performance_limits(self, empty: Campaign) -> None:
        """Raise an error for limits of unknown measures, and for invalid limits or measures."""
        for name, value in self.limits.items():
            if name not in self.measures:
                empty.measure(name)
            _read_performance_limit(name, value)
        for name, function in self.measures.items():
            if name in empty.measures:
                raise ArgumentError(f"the campaign has a measure '{name}' already: choose another name.")
            if not callable(function):
                raise ArgumentError(f"the measure '{name}' is no function: give one of the campaign.")

    def apply_success_criteria(self, campaign: Campaign) -> Campaign:
        """Return the campaign with limits and user-defined measures added."""
        campaign = replace(
            campaign,
            limits={name: _read_performance_limit(name, value) for name, value in self.limits.items()},
        )
        return replace(
            campaign,
            measured={
                name: _evaluate_user_performance_measure(name, function, campaign)
                for name, function in self.measures.items()
            },
        )


def read_success_criteria(target: Any, measures: Any, limits: Any = None) -> SuccessCriteria:
    """Return the criteria from optional mappings; raise an error for invalid ones."""
    return SuccessCriteria(
        read_optional_mapping(target, "the target of runs", 'write {"q": 0.0}'),
        read_optional_mapping(limits, "the limits of runs", 'write {"q": 0.05}'),
        read_optional_mapping(measures, "the measures of runs", 'write {"miss": lambda campaign: ...}'),
    )


def _read_performance_limit(name: str, value: float) -> float:
    return read_positive_number(value, f"the limit of '{name}'", or_zero=True)


def _evaluate_user_performance_measure(name: str, function: MeasureFunction, campaign: Campaign) -> Array:
    try:
        values = np.asarray(function(campaign), dtype=float)
    except (TypeError, ValueError) as error:
        raise ArgumentError(
            f"the measure '{name}' returns no numbers ({format_exception(error)}): return an array ({len(campaign)},)."
        ) from error
    if values.shape != (len(campaign),):
        raise ArgumentError(
            f"the measure '{name}' has the shape {values.shape}: return one number per run, ({len(campaign)},)."
        )
    return values


@suggest_keywords
def monte_carlo(
    loop: ClosedLoop,
    n: int,
    *,
    x0: ArrayLike | Mapping[str, ArrayLike],
    tf: float,
    t0: float = 0.0,
    seed: int = 0,
    dispersions: Dispersions | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    target: Mapping[str, ArrayLike] | None = None,
    limits: Mapping[str, float] | None = None,
    measures: Mapping[str, MeasureFunction] | None = None,
    executor: Executor | Literal["serial"] | None = None,
    checkpoint: str | Path | None = None,
    progress: bool = False,
) -> Campaign:
    """Return n runs of a closed loop with random parameters, initial states and noise.

    Parameters
    ----------
    loop : ClosedLoop
    n : int
        Number of runs.
    x0 : array (n_states,) or mapping by name
        Nominal initial state.
    t0, tf : float
        Start and end time, s.
    seed : int
        Run i uses the random numbers of ``SeedSequence([seed, i])`` and is bitwise identical on every executor.
    dispersions : mapping
        Dispersions by dotted name of ``loop.layout``, e.g. ``{"plant.m": Normal(0.01, relative=True)}``.
    parameters : mapping
        Changed nominal parameters by dotted name.
    target : mapping
        Final states for comparison, by name; default: the reference at the end.
    limits : mapping
        Largest permitted values by measure (see `Campaign.measure`), e.g. ``{"r_L": 0.05, "angle(sigma)": 0.0087}``.
    measures : mapping
        User-defined measures by name: functions of the campaign that return a number per run.
    executor : concurrent.futures.Executor or "serial", optional
        Default: one process per processor. A Dask cluster: ``client.get_executor()``.
    checkpoint : path, optional
        Folder that stores every batch of runs; a repeated call simulates only the missing runs.
    progress : bool
        Display the numbers of completed and of failed runs.

    Raises
    ------
    ArgumentError, UnknownNameError
        Inconsistent arguments; the message names the cause.
    GncOptError
        The campaign cannot be pickled, no run could be simulated, or the checkpoint belongs to another campaign.

    Examples
    --------
    >>> loop = go.ClosedLoop(cart, go.design_lqr(cart, [0, 0], Q=1, R=1, dt=0.1), dt=0.1)
    >>> asked = {"dispersions": {"initial.q": Normal(0.1)}, "limits": {"q": 0.01}}
    >>> runs = go.monte_carlo(loop, 20, x0=[1, 0], tf=8.0, seed=1, executor="serial", **asked)
    >>> print(runs.pass_rate().passed, "of", len(runs))
    20 of 20
    """
    require_type(loop, ClosedLoop, "the loop of monte_carlo()", "give a ClosedLoop")
    read_integer(n, "the number of runs of monte_carlo()", 1)
    read_integer(seed, "the seed of monte_carlo()", 0)
    dispersions = {} if dispersions is None else dispersions
    compiled_loop = loop.compile(x0, t0=t0, tf=tf, parameters=parameters)
    check_dispersions(dispersions, compiled_loop.layout, compiled_loop.nominal)
    compiled_loop = compiled_loop.with_machine_code(n)
    criteria = read_success_criteria(target, measures, limits)
    mission = CampaignTask(compiled_loop, dict(dispersions), int(seed))
    empty = merge_run_batches(
        compiled_loop, [], seed=mission.seed, n_runs=n, goal=criteria.read_target_states(compiled_loop)
    )
    criteria.check_performance_limits(empty)
    folder = None if checkpoint is None else Path(checkpoint)
    before = [] if folder is None else load_stored_runs(folder, mission, n)
    with (
        _show_campaign_progress(n, progress) as show,
        WorkerPool(_share_task_with_workers(mission, executor), executor, "monte_carlo()") as pool,
    ):

        def store_run_batch(batch: TaskResult[Batch, list[RunBatch]]) -> None:
            for part in get_run_batch_results(batch):
                if folder is not None and part.ending is not None:
                    store_run_batch_file(
                        folder,
                        merge_run_batches(
                            compiled_loop, [part], seed=mission.seed, n_runs=n, goal=empty.target
                        ),
                    )
            show(*_count_runs_and_failures(get_run_batch_results(batch)))

        if before:
            show(*_count_runs_and_failures(before))
        todo = find_unsimulated_batches(n, [part.batch for part in before])
        done = pool.map(CampaignTask.simulate_runs, todo, store_run_batch, halve_run_batch)
    batches = sorted(
        [*before, *(part for batch in done for part in get_run_batch_results(batch))],
        key=lambda part: part.batch.start,
    )
    _require_any_completed_run(batches)
    batches = _regenerate_dispersed_parameters(batches, mission)
    campaign = merge_run_batches(compiled_loop, batches, seed=mission.seed, n_runs=n, goal=empty.target)
    scenario = describe_campaign_scenario(loop, compiled_loop.layout, dispersions)
    return criteria.apply_success_criteria(replace(campaign, interrupted=pool.interrupted, scenario=scenario))


def _show_campaign_progress(total: int, visible: bool) -> AbstractContextManager[Callable[[int, int], None]]:
    if not visible:
        return nullcontext(lambda runs, failed: None)
    from gnc_opt.progress_display import show_campaign_progress

    return show_campaign_progress(total)


def _share_task_with_workers(
    mission: CampaignTask, executor: Executor | Literal["serial"] | None
) -> SharedObject[CampaignTask]:
    remedy = 'define custom dispersions at the top level of a module, or use executor="serial"'
    shared = SharedObject.wrap_picklable_object(mission, "the campaign", remedy)
    if executor is None or isinstance(executor, Executor):
        shared.pickle_shared_object()  # also checked for inherited memory, so that the campaign runs on any executor
    return shared


def _count_runs_and_failures(parts: Sequence[RunBatch]) -> tuple[int, int]:
    runs = sum(len(part.batch) for part in parts)
    endings = [part.ending for part in parts if part.ending is not None]
    return runs, runs - sum(outcome.ok for ending in endings for outcome in ending.outcomes)


def _require_any_completed_run(batches: Sequence[RunBatch]) -> None:
    if not batches or any(part.ending is not None for part in batches):
        return
    remedy = "simulate() one of them to see why"
    if all(part.died for part in batches):
        remedy = (
            "call monte_carlo() below 'if __name__ == \"__main__\":' of the script, or else new processes start "
            f'the campaign again; or {remedy}, or use executor="serial"'
        )
    raise GncOptError(f"no run could be simulated ({batches[0].mishap}): {remedy}.")


def _regenerate_dispersed_parameters(batches: Sequence[RunBatch], mission: CampaignTask) -> list[RunBatch]:
    completed = []
    for part in batches:
        P = part.parameters
        if P is None:
            try:
                P = mission.draw_dispersed_parameters(part.batch)
            except Exception:  # the draw itself is what failed
                P = np.full((mission.compiled_loop.layout.size, len(part.batch)), np.nan)
        completed.append(replace(part, parameters=P))
    return completed
