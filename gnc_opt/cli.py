"""Command line interface.

``gnc-opt new NAME`` and ``gnc-opt examples``; ``gnc-opt solve``, ``gnc-opt multistart`` and ``gnc-opt check FILE``.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from gnc_opt.cli_commands import (
    REFINE_TOLERANCE,
    ExitCode,
    run_check_command,
    run_examples_command,
    run_multistart_command,
    run_new_problem_command,
    run_solve_command,
)
from gnc_opt.errors import GncOptError
from gnc_opt.templates import KINDS

EXIT_CODES = """exit codes:
  0    solved, and no optimality condition fails
  1    solved, but an optimality condition fails (0 with --exit-zero)
  2    invalid input: file, option or problem
  3    not solved
  130  interrupted
  141  broken pipe, as in `gnc-opt examples | head`
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments without the program name; default: ``sys.argv[1:]``.
    """
    args = _build_argument_parser().parse_args(arguments)
    args.command = shlex.join(["gnc-opt", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        code = int(args.run(args))
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # discards output at exit
        return ExitCode.BROKEN_PIPE
    except KeyboardInterrupt:
        print("gnc-opt: interrupted", file=sys.stderr)
        return ExitCode.INTERRUPTED
    except (GncOptError, OSError) as error:
        if args.debug:
            traceback.print_exc()
        print(f"gnc-opt: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT


# --- arguments ----------------------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(ExitCode.BAD_INPUT, f"gnc-opt: {message} (see {self.prog} --help)\n")


def _build_argument_parser() -> argparse.ArgumentParser:
    from gnc_opt.threads_and_package_versions import get_package_version

    parser = _Parser(
        prog="gnc-opt",
        description="Solve and check optimal control problems stated with gnc_opt.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"gnc-opt {get_package_version('gnc_opt')}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)
    _add_new_subcommand_parser(commands)
    _add_examples_subcommand_parser(commands)
    _add_solve_subcommand_parser(commands)
    _add_multistart_subcommand_parser(commands)
    check = commands.add_parser("check", help="report errors of a problem without solving it")
    _add_problem_file_options(check)
    check.set_defaults(run=run_check_command)
    return parser


def _add_new_subcommand_parser(commands: Any) -> None:
    command = commands.add_parser("new", help="write a commented problem file")
    add = command.add_argument
    add("name", metavar="NAME", help="name of the file; .py is added, existing files are not overwritten")
    add("--kind", choices=KINDS, default=KINDS[0], help="kind of problem, default %(default)s")
    add("--debug", action="store_true", help="show the traceback of an error")
    command.set_defaults(run=run_new_problem_command)


def _add_examples_subcommand_parser(commands: Any) -> None:
    command = commands.add_parser("examples", help="list the problems that come with gnc_opt, or run one")
    add = command.add_argument
    add("--debug", action="store_true", help="show the traceback of an error")
    add("name", metavar="NAME", nargs="?", help="problem to run; without it, all are listed")
    add("options", metavar="OPTION", nargs=argparse.REMAINDER, help="options of the problem; see NAME --help")
    command.set_defaults(run=run_examples_command)


def parse_optional_number(text: str) -> float | None:
    """Return a number, or None for "none"; argparse shows the name of this function in errors."""
    return None if text == "none" else float(text)


def _add_solve_subcommand_parser(commands: Any) -> None:
    from gnc_opt.planning.transcription.collocation_families import GAUSS, SCHEMES

    command = commands.add_parser(
        "solve",
        help="solve a problem and check that the solution is optimal",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_problem_file_options(command)
    add = command.add_argument
    add("--mesh", metavar="KxN", help="K equal segments of N points; default: MESH of the file")
    add("--scheme", type=str.upper, choices=SCHEMES, default=GAUSS, help="collocation points")
    add(
        "--tol",
        type=parse_optional_number,
        default=REFINE_TOLERANCE,
        metavar="TOL|none",
        help="refine until the error between the nodes is below this (default 1e-8); none: no refinement",
    )
    add(
        "--structure",
        choices=("auto", "bang-bang", "none"),
        default="auto",
        help="optimise switching times (bang-bang), refine the mesh only (none), or choose (auto, the default)",
    )
    add(
        "--fast",
        action="store_true",
        help="stop when the estimated error of the objective is below --tol; skip the check",
    )
    add("--limit", type=float, metavar="S", help="work limit in CPU seconds (default: that of `solve`, 35)")
    add("--solver-tol", type=float, metavar="TOL", help="tolerance of the NLP solver")
    add("--json", metavar="OUT", help="write the summary as JSON to a file, '-' for standard output")
    add("--report", metavar="DIR", help="write report.html, the solution and figures to a folder")
    add("--author", default="", help="author of the report")
    add("--conditions", action="store_true", help="print every condition of the optimality check")
    add("--no-verify", action="store_true", help="skip the optimality check")
    add("--exit-zero", action="store_true", help="exit with 0 even if the optimality check fails")
    command.set_defaults(run=run_solve_command)


def _add_multistart_subcommand_parser(commands: Any) -> None:
    command = commands.add_parser("multistart", help="search for local minima from many random guesses")
    _add_problem_file_options(command)
    add = command.add_argument
    add("--n", type=int, default=40, help="number of starts, the file's own guess included")
    add("--seed", type=int, default=0, help="seed of the random guesses")
    add("--mesh", metavar="KxN", help="coarse mesh, K equal segments of N points; default: MESH of the file")
    add(
        "--tol",
        type=float,
        default=REFINE_TOLERANCE,
        metavar="TOL",
        help="refine the minima until the error is below this (default 1e-8)",
    )
    add("--structure", choices=("auto", "bang-bang", "none"), default="auto", help="how to refine the minima")
    add("--no-refine", action="store_true", help="leave the minima on the coarse mesh, without a check")
    add("--serial", action="store_true", help="use this process only")
    add("--json", metavar="OUT", help="write the minima as JSON to a file, '-' for standard output")
    command.set_defaults(run=run_multistart_command, report=None)


def _add_problem_file_options(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add("file", metavar="FILE", help="Python file or package with build(**options) returning a Problem")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="option of build(); may be repeated")
    add("--quiet", action="store_true", help="show errors and warnings only")
    add("--debug", action="store_true", help="show the traceback of an error")


if __name__ == "__main__":
    sys.exit(main())
