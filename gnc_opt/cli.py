"""The command line.

``gnc-opt new NAME`` and ``gnc-opt examples``; ``gnc-opt solve``, ``gnc-opt multistart`` and ``gnc-opt check FILE``;
``gnc-opt film FILE``.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from gnc_opt.errors import GncOptError, ProblemWarning
from gnc_opt.examples import example, examples
from gnc_opt.problem_file import ProblemFile, load_problem_file, parse_setting
from gnc_opt.templates import KINDS, write_template

if TYPE_CHECKING:
    from rich.console import Console

    from gnc_opt.nlp import SolverOptions
    from gnc_opt.problem.problem import Problem
    from gnc_opt.simulation import Run
    from gnc_opt.solution.solution import Solution
    from gnc_opt.verify.verdict import Verdict


REFINE_TOLERANCE = 1e-8
"""What --tol is where it is not given: an answer is refined until it can be judged."""


class ExitCode(IntEnum):
    """What the shell is told."""

    OK = 0
    VERDICT_FAILS = 1
    BAD_INPUT = 2
    NOT_SOLVED = 3
    INTERRUPTED = 130
    UNREAD = 141


EXIT_CODES = """exit codes:
  0    solved, and no optimality condition fails
  1    solved, but the verdict fails: the answer is not what it claims to be (--exit-zero turns this into 0)
  2    bad input: the file, an option or the problem is wrong
  3    not solved
  130  interrupted
  141  nobody reads on what it prints, as in `gnc-opt examples | head`
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; default ``sys.argv[1:]``.
    """
    args = _parser().parse_args(arguments)
    args.command = shlex.join(["gnc-opt", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        code = int(args.run(args))
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        os.dup2(
            os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
        )  # what is left is not written at the exit
        return ExitCode.UNREAD
    except KeyboardInterrupt:
        print("gnc-opt: interrupted", file=sys.stderr)
        return ExitCode.INTERRUPTED
    except (GncOptError, OSError) as error:
        if args.debug:
            traceback.print_exc()
        print(f"gnc-opt: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT


# --- commands -----------------------------------------------------------------------------------------


def _solve(args: argparse.Namespace) -> ExitCode:
    from gnc_opt.solution.failure import failure_message
    from gnc_opt.solve import solve

    _check_targets(args)
    console = _console(args)
    with _warnings_as_lines():
        file, problem = _build(args)
        solution = solve(
            problem,
            mesh=args.mesh or file.mesh,
            scheme=args.scheme,
            tol=args.tol,
            structure=args.structure,
            options=_solver_options(args),
            progress=not args.quiet,
            throw=False,
        )
        verdict = _verify(solution) if solution.status.solved and not args.no_verify else None
    if args.quiet and not solution.status.solved:
        print(f"gnc-opt: {failure_message(solution)}", file=sys.stderr)
    _show(console, solution, verdict)
    _write(args, console, file, solution, verdict)
    return _exit_code(solution, verdict, args.exit_zero)


def _multistart(args: argparse.Namespace) -> ExitCode:
    from gnc_opt.refine import multistart
    from gnc_opt.report.search import search_text, write_search

    _check_targets(args)
    options = dict(parse_setting(text) for text in args.set)
    with _warnings_as_lines():
        file = load_problem_file(args.file)
        found = multistart(
            partial(_built_problem, args.file, options),
            n=args.n,
            seed=args.seed,
            mesh=args.mesh or file.mesh,
            tol=args.tol,
            structure=args.structure,
            refine=not args.no_refine,
            executor="serial" if args.serial else None,
            progress=not args.quiet,
        )
    _say(_console(args), str(found))
    if args.json == "-":
        print(search_text(found), end="")
    elif args.json is not None:
        write_search(args.json, found)
    if found.interrupted:
        return ExitCode.INTERRUPTED
    return ExitCode.OK if found.minima else ExitCode.NOT_SOLVED


def _built_problem(path: str, options: dict[str, Any]) -> Problem:
    """Build a file's problem, in this process or another one."""
    return load_problem_file(path).build(options)


def _check(args: argparse.Namespace) -> ExitCode:
    with _warnings_as_lines():
        file, problem = _build(args)
        problem.check()
    _say(_console(args), _description(file, problem))
    return ExitCode.OK


def _new(args: argparse.Namespace) -> ExitCode:
    path = write_template(args.name, args.kind)
    command = shlex.join(["gnc-opt", "solve", str(path), "--report", "report"])
    print(f"written: {path}\nsolve it with: {command}")
    return ExitCode.OK


def _examples(args: argparse.Namespace) -> int:
    if args.name is not None:
        return example(args.name).run(args.options)
    found = examples()
    width = max(len(each.name) for each in found)
    print("\n".join(f"{each.name:{width}}  {each.title}" for each in found))
    print(f"run one with: gnc-opt examples NAME\nread them in: {found[0].path.parent}")
    return ExitCode.OK


def _film(args: argparse.Namespace) -> ExitCode:
    from gnc_opt.plot import View, save_film

    view = View(
        args.position if len(args.position) > 1 else args.position[0],
        args.attitude,
        args.force,
        {f"keep-out {i + 1}": (sphere[:3], sphere[3]) for i, sphere in enumerate(args.keep_out)},
        args.down,
    )
    others = [_moved(other) for other in args.others]
    path = save_film(
        _moved(args.file), args.output, view, others=others, seconds=args.seconds, rate=args.rate
    )
    print(f"written: {path}")
    return ExitCode.OK


def _moved(path: str) -> Solution | Run:
    """Load a solution or a run."""
    from gnc_opt.simulation import Run
    from gnc_opt.solution import load

    try:
        return load(path)
    except GncOptError as error:
        try:
            return Run.load(path)
        except GncOptError:
            raise error from None


def _build(args: argparse.Namespace) -> tuple[ProblemFile, Problem]:
    options = dict(parse_setting(text) for text in args.set)
    file = load_problem_file(args.file)
    return file, file.build(options)


def _verify(solution: Solution) -> Verdict:
    from gnc_opt.verify import verify

    return verify(solution)


def _solver_options(args: argparse.Namespace) -> SolverOptions:
    from gnc_opt.nlp import SolverOptions

    return SolverOptions() if args.solver_tol is None else SolverOptions(tolerance=args.solver_tol)


def _exit_code(solution: Solution, verdict: Verdict | None, exit_zero: bool) -> ExitCode:
    if solution.status.value == "interrupted":
        return ExitCode.INTERRUPTED
    if not solution.status.solved:
        return ExitCode.NOT_SOLVED
    if verdict is None or verdict.ok or exit_zero:
        return ExitCode.OK
    return ExitCode.VERDICT_FAILS


# --- output -------------------------------------------------------------------------------------------


def _console(args: argparse.Namespace) -> Console:
    """Where people read: standard output, or standard error if that carries JSON."""
    from rich.console import Console

    console = Console(stderr=getattr(args, "json", None) == "-", quiet=args.quiet, highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, 120)
    return console


def _say(console: Console, text: Any) -> None:
    console.print(text, markup=False, soft_wrap=True)


def _show(console: Console, solution: Solution, verdict: Verdict | None) -> None:
    from gnc_opt.report.verdict_table import verdict_table

    _say(console, str(solution))
    if solution.history is not None:
        _say(console, str(solution.history))
    if verdict is None:
        return
    console.print(verdict_table(verdict))
    for condition in verdict.failed:
        _say(console, f"{condition.name}: {condition.meaning}")


def _write(
    args: argparse.Namespace, console: Console, file: ProblemFile, solution: Solution, verdict: Verdict | None
) -> None:
    from gnc_opt.report.report import write_report
    from gnc_opt.report.summary_json import json_text, write_json

    if args.json == "-":
        print(json_text(solution, verdict), end="")
    elif args.json is not None:
        write_json(args.json, solution, verdict)
    if args.report is not None:
        paths = write_report(
            solution, verdict, args.report, figures=file.figures, view=file.view, command=args.command
        )
        _say(console, f"report: {paths[0]}")


def _description(file: ProblemFile, problem: Problem) -> str:
    lines = [f"{problem.name}: well stated"]
    for leg in problem.phases.values():
        states, controls = leg.model.states, leg.model.controls
        lines.append(
            f"  phase {leg.name}: {_count(states.size, 'state')} ({', '.join(states.names)}), "
            f"{_count(controls.size, 'control')} ({', '.join(controls.names)}), "
            f"{_count(len(leg.path_labels), 'path constraint')}, {_count(len(leg.integrands), 'integral')}"
        )
    lines.append(
        f"  {_count(len(problem.constraint_labels()), 'boundary constraint')} besides the end values, "
        f"{_count(problem.parameters.size, 'free parameter')}, "
        f"cost {'maximised' if problem.sense < 0 else 'minimised'}"
    )
    options = ", ".join(str(parameter) for parameter in file.options.values())
    lines.append(f"  options of build(): {options or 'none'}")
    return "\n".join(lines)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _check_targets(args: argparse.Namespace) -> None:
    """Refuse places that cannot be written to before the work starts, not after it."""
    if args.json not in (None, "-"):
        target = Path(args.json)
        if target.is_dir() or not target.parent.is_dir():
            raise GncOptError(f"--json {args.json}: name a file in a folder that exists.")
    if args.report is not None and Path(args.report).exists() and not Path(args.report).is_dir():
        raise GncOptError(f"--report {args.report}: this is a file; name a folder.")


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Show gnc_opt's warnings as one line each, without the place in the code; leave others alone."""

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, ProblemWarning):
            print(f"gnc-opt: warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *place, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ProblemWarning)
        usual, warnings.showwarning = warnings.showwarning, show
        yield


# --- arguments ----------------------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    """Reports a wrong option in one sentence, like every other bad input."""

    def error(self, message: str) -> NoReturn:
        self.exit(ExitCode.BAD_INPUT, f"gnc-opt: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    from gnc_opt.versions import package_version

    parser = _Parser(
        prog="gnc-opt",
        description="Solve and check optimal control problems stated with gnc_opt.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gnc-opt {package_version('gnc_opt')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)
    _add_new(commands)
    _add_examples(commands)
    _add_film(commands)
    _add_solve(commands)
    _add_multistart(commands)
    check = commands.add_parser("check", help="look for mistakes in a problem without solving it")
    _add_common(check)
    check.set_defaults(run=_check)
    return parser


def _add_new(commands: Any) -> None:
    command = commands.add_parser("new", help="write a problem file to start from")
    add = command.add_argument
    add("name", metavar="NAME", help="of the file; .py is added, and what exists is never overwritten")
    add("--kind", choices=KINDS, default=KINDS[0], help="what it states, default %(default)s")
    add("--debug", action="store_true", help="show the traceback of an error")
    command.set_defaults(run=_new)


def _add_examples(commands: Any) -> None:
    command = commands.add_parser("examples", help="list the problems that come with gnc_opt, or run one")
    add = command.add_argument
    add("--debug", action="store_true", help="show the traceback of an error")
    add("name", metavar="NAME", nargs="?", help="of the problem to run; without it they are listed")
    add(
        "options",
        metavar="OPTION",
        nargs=argparse.REMAINDER,
        help="of the problem; try --help after its NAME",
    )
    command.set_defaults(run=_examples)


def _add_film(commands: Any) -> None:
    command = commands.add_parser("film", help="film a solution or a run that was saved")
    add = command.add_argument
    add("file", metavar="FILE", help="solution or run (.npz)")
    add(
        "--position",
        metavar="STATE",
        nargs="+",
        required=True,
        help="of two or three components, or as many states",
    )
    add(
        "--attitude", metavar="STATE", help="modified Rodrigues parameters or a quaternion, scalar part first"
    )
    add("--force", metavar="CONTROL", help="whose plume is drawn; in body axes if there is an attitude")
    add(
        "--keep-out",
        metavar=("X", "Y", "Z", "RADIUS"),
        type=float,
        nargs=4,
        action="append",
        default=[],
        help="sphere to draw; may be given several times",
    )
    add("--down", action="store_true", help="draw z downwards")
    add("--others", metavar="FILE", nargs="+", default=[], help="whose paths are drawn in grey")
    add("--seconds", metavar="S", type=float, default=8.0, help="length of the film, default %(default)g")
    add("--rate", metavar="N", type=float, default=20.0, help="pictures per second, default %(default)g")
    add(
        "-o",
        "--output",
        metavar="FILE",
        default="film.gif",
        help=".gif, or .mp4 by ffmpeg; default %(default)s",
    )
    add("--debug", action="store_true", help="show the traceback of an error")
    command.set_defaults(run=_film)


def number_or_none(text: str) -> float | None:
    """Read a number, or "none"; argparse names this function where it is neither."""
    return None if text == "none" else float(text)


def _add_solve(commands: Any) -> None:
    from gnc_opt.transcription.scheme import GAUSS, SCHEMES

    command = commands.add_parser(
        "solve",
        help="solve a problem and judge the answer",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_common(command)
    add = command.add_argument
    add("--mesh", metavar="KxN", help="K equal segments of N points; default: MESH of the file")
    add("--scheme", type=str.upper, choices=SCHEMES, default=GAUSS, help="collocation points")
    add(
        "--tol",
        type=number_or_none,
        default=REFINE_TOLERANCE,
        metavar="TOL|none",
        help="refine until the error between the nodes is below this (default 1e-8); none: leave it at the mesh",
    )
    add(
        "--structure",
        choices=("auto", "bang-bang", "none"),
        default="auto",
        help="how to refine: exact switch times, hp, or whichever suits (auto, the default)",
    )
    add("--solver-tol", type=float, metavar="TOL", help="tolerance of the NLP solver")
    add("--json", metavar="OUT", help="write the summary as JSON to a file, '-' for standard output")
    add("--report", metavar="DIR", help="write report.html, the solution and figures to a folder")
    add("--no-verify", action="store_true", help="skip the verdict")
    add("--exit-zero", action="store_true", help="exit with 0 even if the verdict fails")
    command.set_defaults(run=_solve)


def _add_multistart(commands: Any) -> None:
    command = commands.add_parser("multistart", help="look for local minima from many random guesses")
    _add_common(command)
    add = command.add_argument
    add("--n", type=int, default=40, help="number of starts, the file's own guess included")
    add("--seed", type=int, default=0, help="of the random guesses")
    add("--mesh", metavar="KxN", help="coarse mesh, K equal segments of N points; default: MESH of the file")
    add(
        "--tol",
        type=float,
        default=REFINE_TOLERANCE,
        metavar="TOL",
        help="refine the minima until the error is below this (default 1e-8)",
    )
    add("--structure", choices=("auto", "bang-bang", "none"), default="auto", help="how to refine the minima")
    add("--no-refine", action="store_true", help="leave the minima on the coarse mesh, unjudged")
    add("--serial", action="store_true", help="use this process only")
    add("--json", metavar="OUT", help="write the minima as JSON to a file, '-' for standard output")
    command.set_defaults(run=_multistart, report=None)


def _add_common(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add("file", metavar="FILE", help="Python file or package with build(**options) returning a Problem")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="option of build(); may be repeated")
    add("--quiet", action="store_true", help="show nothing but errors and warnings")
    add("--debug", action="store_true", help="show the traceback of an error")


if __name__ == "__main__":
    sys.exit(main())
