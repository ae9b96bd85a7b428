"""Commands of the command line and their output."""

from __future__ import annotations

import argparse
import shlex
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gnc_opt.errors import GncOptError, ProblemWarning
from gnc_opt.problem_files_and_examples import (
    ProblemFile,
    find_example,
    list_examples,
    load_problem_file,
    parse_build_option,
)
from gnc_opt.templates import write_template_file
from gnc_opt.text_html_and_json_formatting import format_json, pluralise_noun

if TYPE_CHECKING:
    from rich.console import Console

    from gnc_opt.planning.nlp import SolverOptions
    from gnc_opt.planning.problem.problem import Problem
    from gnc_opt.planning.solution.optimality_verdict import Verdict
    from gnc_opt.planning.solution.solution import Solution


REFINE_TOLERANCE = 1e-8
"""Default of --tol."""


class ExitCode(IntEnum):
    """Exit codes of the commands."""

    OK = 0
    CONDITIONS_FAIL = 1
    BAD_INPUT = 2
    NOT_SOLVED = 3
    INTERRUPTED = 130
    BROKEN_PIPE = 141


# --- commands -----------------------------------------------------------------------------------------


def run_solve_command(args: argparse.Namespace) -> ExitCode:
    from gnc_opt.planning.direct.computation_budget import RefinementLimits
    from gnc_opt.planning.direct.solve_failure_report import format_solve_failure_message
    from gnc_opt.planning.optimal_control_solver import solve
    from gnc_opt.planning.verification import verify

    _check_output_file_paths(args)
    console = _configure_console_output(args)
    with _show_warnings_on_one_line():
        file, problem = _load_problem_from_arguments(args)
        solution = solve(
            problem,
            mesh=args.mesh or file.default_mesh,
            scheme=args.scheme,
            tol=args.tol,
            structure=args.structure,
            check=not args.fast,
            limits=RefinementLimits() if args.limit is None else RefinementLimits(max_work=args.limit),
            options=_read_solver_options(args),
            progress=not args.quiet,
            throw=False,
        )
        checked = solution.status.solved and not (args.fast or args.no_verify)
        verdict = verify(solution) if checked else None
    if args.quiet and not solution.status.solved:
        print(f"gnc-opt: {format_solve_failure_message(solution)}", file=sys.stderr)
    _print_solution_summary(console, solution, verdict, args.conditions)
    _write_requested_output_files(args, console, file, solution, verdict)
    return _choose_exit_code(solution, verdict, args.exit_zero)


def run_multistart_command(args: argparse.Namespace) -> ExitCode:
    from gnc_opt.planning.study import multistart
    from gnc_opt.report import search_dict, write_json

    _check_output_file_paths(args)
    options = dict(parse_build_option(text) for text in args.set)
    with _show_warnings_on_one_line():
        file = load_problem_file(args.file)
        found = multistart(
            partial(_load_and_build_problem, args.file, options),
            n=args.n,
            seed=args.seed,
            mesh=args.mesh or file.default_mesh,
            tol=args.tol,
            structure=args.structure,
            refine=not args.no_refine,
            executor="serial" if args.serial else None,
            progress=not args.quiet,
        )
    _print_plain_text(_configure_console_output(args), str(found))
    if args.json == "-":
        print(format_json(search_dict(found)), end="")
    elif args.json is not None:
        write_json(args.json, found)
    if found.interrupted:
        return ExitCode.INTERRUPTED
    return ExitCode.OK if found.minima else ExitCode.NOT_SOLVED


def _load_and_build_problem(path: str, options: dict[str, Any]) -> Problem:
    return load_problem_file(path).build(options)


def run_check_command(args: argparse.Namespace) -> ExitCode:
    with _show_warnings_on_one_line():
        file, problem = _load_problem_from_arguments(args)
        problem.check()
    _print_plain_text(_configure_console_output(args), _format_problem_summary(file, problem))
    return ExitCode.OK


def run_new_problem_command(args: argparse.Namespace) -> ExitCode:
    path = write_template_file(args.name, args.kind)
    command = shlex.join(["gnc-opt", "solve", str(path), "--report", "report"])
    print(f"written: {path}\nsolve it with: {command}")
    return ExitCode.OK


def run_examples_command(args: argparse.Namespace) -> int:
    if args.name is not None:
        return find_example(args.name).run(args.options)
    found = list_examples()
    width = max(len(each.name) for each in found)
    print("\n".join(f"{each.name:{width}}  {each.title}" for each in found))
    print(f"run one with: gnc-opt examples NAME\nread them in: {found[0].problems}")
    return ExitCode.OK


def _load_problem_from_arguments(args: argparse.Namespace) -> tuple[ProblemFile, Problem]:
    options = dict(parse_build_option(text) for text in args.set)
    file = load_problem_file(args.file)
    return file, file.build(options)


def _read_solver_options(args: argparse.Namespace) -> SolverOptions:
    from gnc_opt.planning.nlp import SolverOptions

    return SolverOptions() if args.solver_tol is None else SolverOptions(tolerance=args.solver_tol)


def _choose_exit_code(solution: Solution, verdict: Verdict | None, exit_zero: bool) -> ExitCode:
    if solution.status.value == "interrupted":
        return ExitCode.INTERRUPTED
    if not solution.status.solved:
        return ExitCode.NOT_SOLVED
    if verdict is None or verdict.ok or exit_zero:
        return ExitCode.OK
    return ExitCode.CONDITIONS_FAIL


def _configure_console_output(args: argparse.Namespace) -> Console:
    """Return the console for text: standard output, or standard error if JSON goes to standard output."""
    from rich.console import Console

    console = Console(stderr=getattr(args, "json", None) == "-", quiet=args.quiet, highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, 120)
    return console


def _print_plain_text(console: Console, text: Any) -> None:
    console.print(text, markup=False, soft_wrap=True)


def _print_solution_summary(
    console: Console, solution: Solution, verdict: Verdict | None, conditions: bool
) -> None:
    """Print the summary, the iterations of a refinement that did not converge, and the optimality check."""
    _print_plain_text(console, str(solution))
    if solution.history is not None and not solution.history.converged:
        _print_plain_text(console, str(solution.history))
    if verdict is not None:
        _print_plain_text(console, verdict.table() if conditions else str(verdict))


def _write_requested_output_files(
    args: argparse.Namespace, console: Console, file: ProblemFile, solution: Solution, verdict: Verdict | None
) -> None:
    from gnc_opt.report import summary_dict, write_json
    from gnc_opt.report.solution_report_folder import write_report

    if args.json == "-":
        print(format_json(summary_dict(solution, verdict)), end="")
    elif args.json is not None:
        write_json(args.json, solution, verdict)
    if args.report is not None:
        about = {
            "view": file.view,
            "description": file.describe_problem_builder(dict(parse_build_option(text) for text in args.set)),
            "command": args.command,
            "author": args.author,
        }
        paths = write_report(solution, verdict, args.report, **about)
        _print_plain_text(console, f"report: {paths[0]}")


def _format_problem_summary(file: ProblemFile, problem: Problem) -> str:
    lines = [f"{problem.name}: no error in the statement"]
    for phase in problem.phases.values():
        states, controls = phase.model.states, phase.model.controls
        lines.append(
            f"  phase {phase.name}: {pluralise_noun(states.size, 'state')} ({', '.join(states.names)}), "
            f"{pluralise_noun(controls.size, 'control')} ({', '.join(controls.names)}), "
            f"{pluralise_noun(len(phase.path_labels), 'path constraint')}, "
            f"{pluralise_noun(len(phase.integrands), 'integral')}"
        )
    lines.append(
        f"  {pluralise_noun(len(problem.constraint_labels()), 'boundary constraint')} besides the end values, "
        f"{pluralise_noun(problem.parameters.size, 'free parameter')}, "
        f"cost {'maximised' if problem.sense < 0 else 'minimised'}"
    )
    options = ", ".join(str(p.replace(annotation=p.empty)) for p in file.builder_options.values())
    lines.append(f"  options of build(): {options or 'none'}")
    return "\n".join(lines)


def _check_output_file_paths(args: argparse.Namespace) -> None:
    """Raise an error for invalid output paths before the computation starts."""
    if args.json not in (None, "-"):
        target = Path(args.json)
        if target.is_dir() or not target.parent.is_dir():
            raise GncOptError(f"--json {args.json}: name a file in a folder that exists.")
    if args.report is not None and Path(args.report).exists() and not Path(args.report).is_dir():
        raise GncOptError(f"--report {args.report}: this is a file; name a folder.")


@contextmanager
def _show_warnings_on_one_line() -> Iterator[None]:
    """Show warnings of gnc_opt on one line without their source location; other warnings are unchanged."""

    def show_warning_on_one_line(
        message: Warning | str, category: type[Warning], *place: Any, **more: Any
    ) -> None:
        if issubclass(category, ProblemWarning):
            print(f"gnc-opt: warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *place, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ProblemWarning)
        usual, warnings.showwarning = warnings.showwarning, show_warning_on_one_line
        yield
