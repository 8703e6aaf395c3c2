"""The command-line application, which imports the modules of a command only when the command is called."""

import errno
import gc
import os
import re
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from contextlib import redirect_stdout, suppress
from contextvars import ContextVar
from functools import cache, partial
from importlib import import_module
from inspect import Parameter, Signature, signature
from itertools import pairwise
from textwrap import indent
from typing import Annotated

import typer
from typer.core import TyperCommand, TyperGroup

import rfpsurvey as rs

# The exit code that a shell reports for a program that writes to a closed pipe.
READER_GONE = 141
TASKS = {
    "Plan a tile": ("plan", "score", "compare-allocators", "paths", "convert", "instruments"),
    "Plan and live with a survey": (
        "tile",
        "survey",
        "night",
        "record",
        "status",
        "diff",
        "export",
        "select",
        "potential",
    ),
    "Compare designs of positioners": ("compare", "design", "probability", "benchmark"),
}
"""Commands of each task, in the order in which they are listed."""
COMMANDS = {
    "compare": "Compare the patrol areas, fibers and collisions of instruments, and the targets lost to collisions.",
    "compare-allocators": "Compare allocators on the same field.",
    "convert": "Convert a plan to the format of another program.",
    "design": "Scan designs of positioners, optionally around the design of an instrument, and find the best designs.",
    "diff": "List the tiles and fibers that differ between two plans of a survey, and the reasons.",
    "export": "Write tiles of a survey to files in the format of an observatory, one file for each tile.",
    "instruments": "List all instruments, describe one instrument with the source of every value, or compare several "
    "instruments.",
    "night": "Choose the tiles of a survey that are observed in a night, with their times, and write them to files.",
    "paths": "Plan paths of all arms between the folded poses and a plan, and prove that no arms collide.",
    "plan": "Assign the targets of a field to fibers, and find the arms that collide.",
    "potential": "Find the tiles and positioners that reach each point of a catalog of random points.",
    "probability": "Estimate the probability that arms collide, with a confidence interval.",
    "record": "Record what was observed, or which tiles and targets changed, in the folder of a survey.",
    "score": "Find the collisions in an assignment that was made by another program.",
    "select": "Plan a survey many times with random subpriorities, and write the probability that each target is "
    "observed.",
    "status": "Print what a survey has observed, what is planned, and what remains.",
    "survey": "Plan the tiles of a survey so that as many targets as possible are observed the requested number of "
    "times.",
    "tile": "Place the tiles of a survey.",
    "benchmark": "Measure the speed and the errors of the methods that find collisions or estimate collision "
    "probabilities, for the arms of an instrument.",
}
"""Summary of each command, stored here so that the list of commands is printed without importing the commands."""
MODULES = {
    **dict.fromkeys(("compare-allocators", "benchmark"), "compare"),
    **dict.fromkeys(("instruments", "probability"), "plan"),
    **dict.fromkeys(("diff", "record", "status"), "survey"),
    **dict.fromkeys(("paths", "score"), "tile"),
    "convert": "export",
    "potential": "select",
}
"""Modules of the commands that share a module with the command of its name."""
FLAGS = {"verbose": "Print more than the result.", "quiet": "Print only warnings and errors."}
"""Options of all commands, and their help."""
VERBOSE = ContextVar("VERBOSE", default=False)
"""Whether the command prints more than its result."""
INNER = {"standard_error": "precision"}
"""Names in messages of the library that are not the names of options, and the names of these options."""


class Command(TyperCommand):
    """A command whose help ends with the examples in the docstring of its function."""

    def __init__(self, *args, help: str | None, **options):  # noqa: A002
        # the option -OO of Python removes docstrings
        text, _, examples = (help or "").partition("\n\nExamples\n--------\n")
        options["epilog"] = f"\b\nExamples:\n{indent(examples, '  ')}" if examples else options["epilog"]
        super().__init__(*args, help=text, **options)


def with_level(function: Callable) -> Callable:
    """Return the function of a command with the options --verbose and --quiet."""

    def call(*arguments, verbose: bool = False, quiet: bool = False, **options) -> object:
        if verbose and quiet:
            raise rs.InputError("either --verbose or --quiet must be given, got both")
        VERBOSE.set(verbose)
        if not quiet:
            return function(*arguments, **options)
        with open(os.devnull, "w") as sink, redirect_stdout(sink):
            return function(*arguments, **options)

    more = [
        Parameter(
            name,
            Parameter.KEYWORD_ONLY,
            annotation=Annotated[bool, typer.Option(f"--{name}", help=text)],
            default=False,
        )
        for name, text in FLAGS.items()
    ]
    parameters = [p.replace(kind=Parameter.KEYWORD_ONLY) for p in signature(function).parameters.values()]
    call.__signature__ = Signature([*parameters, *more])
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in [*parameters, *more]}
    call.__name__, call.__doc__ = function.__name__, function.__doc__
    vars(call).update({name: value for name, value in vars(function).items() if name == "keys"})
    return call


class Commands(TyperGroup):
    """The group of all commands."""

    def list_commands(self, ctx) -> list[str]:
        """Return the names of all commands."""
        return [name for names in TASKS.values() for name in names]

    def get_command(self, ctx, name: str):
        """Import a command and return it; return None if there is no command of this name."""
        if name not in COMMANDS:
            return None
        # Imported objects exist until the program ends. Excluding them from garbage collection saves time. Compiling
        # functions makes many objects and little garbage, so that a rarer garbage collection also saves time.
        gc.set_threshold(50_000, 20, 1000)
        gc.disable()
        try:
            import_module(f"rfpsurvey._cli.{MODULES.get(name, name)}")
            if name not in self.commands:
                self.commands[name] = typer.main.get_command(app).commands[name]
                gc.freeze()
        finally:
            gc.enable()
        warnings.simplefilter("always", rs.RfpsurveyWarning)
        announce_compilation()
        return self.commands[name]

    def format_commands(self, ctx, formatter) -> None:
        """Write the list of commands."""
        for task, names in TASKS.items():
            with formatter.section(task):
                formatter.write_dl([(name, COMMANDS[name]) for name in names])


def announce_compilation() -> None:
    """Prepare a message that is printed when numba compiles a function, but only if standard error is a terminal."""
    if not sys.stderr.isatty():
        return
    from numba.core import event  # the list of commands needs no numba

    text = "rfpsurvey: compiling functions for this machine; this happens only once and takes a few seconds"
    tell = cache(partial(print, text, file=sys.stderr))  # a second call prints nothing

    class Announcement(event.Listener):
        def on_start(self, _) -> None:
            tell()

        on_end = on_start

    event.register("numba:compile", Announcement())


app = typer.Typer(
    cls=Commands,
    help="Assign targets to theta-phi fiber positioners and find collisions between the arms of positioners.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    # the help is as wide as the terminal
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 200},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rfpsurvey {rs.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    pass


@cache
def commands() -> Commands:
    """Return the group of all commands, which keeps the commands that were imported."""
    return typer.main.get_command(app)


def run() -> int:
    """Run the command that the user typed, and return the exit code; for invalid input, print one sentence."""
    warnings.showwarning = _show_warning
    warnings.filterwarnings("ignore", module="astropy")
    code = 0
    try:
        _check_words(["rfpsurvey", *sys.argv[1:]])
        commands()()
    except SystemExit as stop:  # typer raises SystemExit when a command ends, even if a pipe was closed
        code = READER_GONE if isinstance(stop.__context__, BrokenPipeError) else stop.code
    except BrokenPipeError:
        code = READER_GONE
    except (rs.InputError, OSError, BrokenExecutor) as error:
        code = _complain(error)
    return _flush(code)


def _check_words(words: list[str]) -> None:
    """Raise an error for an empty word, such as the value of a variable of the shell that is not set."""
    for before, word in pairwise(words):
        if not word.strip():
            raise rs.InputError(f"the word after {before} must not be empty, got {word!r}")
        option, sign, value = word.partition("=")
        if option.startswith("--") and sign and not value.strip():
            raise rs.InputError(f"{option} must have a value, got {value!r}")


def _show_warning(message: Warning | str, *_: object) -> None:
    """Print a warning as one line."""
    print(f"rfpsurvey: warning: {_with_options(str(message), sys.argv[1:])}", file=sys.stderr)


def _complain(error: Exception) -> int:
    """Print the message of an error as one line, and return the exit code for invalid input."""
    from rfpsurvey.errors import one_line

    closed = isinstance(error, OSError) and error.errno == errno.EBADF
    text = "standard output is closed" if closed else one_line(" ".join(str(error).split()))
    with suppress(BrokenPipeError):
        print(f"rfpsurvey: {_with_options(text, sys.argv[1:])}", file=sys.stderr)
    return 2


def _with_options(text: str, words: list[str]) -> str:
    """Replace the names of parameters in a message by the options, or the keys after --set, that the user typed.

    Of two forms of a remedy, such as "overwrite=True (or --overwrite)", only the option remains.
    """
    names = dict.fromkeys(word.partition("=")[0] for word in words)
    typed = {name[2:].replace("-", "_"): name for name in names if name.startswith("--")}
    typed |= {inner: typed[name] for inner, name in INNER.items() if name in typed}
    typed |= {name.rpartition(".")[2]: name for name in names if re.fullmatch(r"[a-z_]+(\.[a-z_]+)+", name)}

    def option(match: re.Match) -> str:
        return match[0] if match[0] in names else typed.get(match[0].rpartition(".")[2], match[0])

    text = re.sub(r"[a-z_]+=\S* \(or (--[^)]+)\)", r"\1", text)
    # a name before "must" is a parameter; elsewhere, only names with an underscore (and rng) differ from words
    text = re.sub(r"^[a-z_.]+(?= (must|has no effect) )", option, text)
    return re.sub(r"(?<![\w'=.-])(rng|[a-z]+(_[a-z]+)+)(?![\w'=(])", option, text)


def _flush(code: int) -> int:
    """Flush standard output and standard error, report errors that occur, and return the exit code of the program."""
    for stream in filter(None, (sys.__stdout__, sys.__stderr__)):
        try:
            stream.flush()
        except OSError as error:
            gone = isinstance(error, BrokenPipeError)
            code = READER_GONE if gone else _complain(error)
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # Python flushes the stream again at exit
        except ValueError:  # the stream is closed
            pass
    return code
