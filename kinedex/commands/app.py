"""Define the application `kinedex`: its help page, the options of every command, and the report of errors."""

from __future__ import annotations

import errno
import functools
import inspect
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from kinedex.commands.command_list import ASK as ASK
from kinedex.commands.command_list import COMMANDS, PANELS
from kinedex.commands.command_list import MAINTAIN as MAINTAIN
from kinedex.commands.command_list import RUN as RUN
from kinedex.commands.command_list import SEARCH as SEARCH
from kinedex.commands.command_list import TRACK as TRACK
from kinedex.console.plain_values import convert_plain_values
from kinedex.ops.errors import KinedexError, Remedy
from kinedex.ops.wording import visible_lines

FAILED, LEFT_OUT, TIMED_OUT, INTERRUPTED = 1, 3, 124, 130
"""Exit codes: failed; done, but source files or labels were excluded; ended by `--timeout`; stopped by Ctrl-C."""

_CODES = {"TimeLimitError": TIMED_OUT}
"""A dict from class of an error to exit code, for codes other than `FAILED`."""

Function = TypeVar("Function", bound=Callable[..., None])


class HelpPage(TyperGroup):
    """A group of commands whose help lists them by section, and whose usage errors are JSON if `--json` is given."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, then the options in one paragraph, so that the page fits on a screen."""
        self.format_commands(ctx, formatter)
        options = ", ".join(one.opts[0] for one in self.get_params(ctx) if one.opts[0] != "--help")
        if ctx.parent is not None:
            formatter.write_paragraph()
        formatter.write_text(f"Options: {options}{', ' * bool(options)}COMMAND --help")

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section of the help for each panel of commands; the help of a subgroup has one section."""
        commands = self.listed()
        width = max(len(name) for name, _ in commands)
        formatter.write_paragraph()
        for panel in (*PANELS, None):
            rows = [
                (name.ljust(width), one.get_short_help_str(formatter.width - width - 4))
                for name, one in commands
                if one.rich_help_panel == panel
            ]
            if rows:
                formatter.write_heading(panel or "Commands")
                formatter.indent()
                formatter.write_dl(rows)
                formatter.dedent()

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options of the group."""
        convert_plain_values(self.get_params(ctx))
        return super().parse_args(ctx, args)

    def listed(self) -> list[tuple[str, Any]]:
        """Return the commands for the help, with their names."""
        return list(self.commands.items())

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that the arguments name."""
        with _usage_errors(args):
            return super().resolve_command(ctx, args)


class Command(TyperCommand):
    """A command whose usage errors are JSON if `--json` is given."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments and options of the command."""
        convert_plain_values(self.get_params(ctx))
        with _usage_errors(args):
            return super().parse_args(ctx, args)


@contextmanager
def _usage_errors(args: list[str]) -> Iterator[None]:
    """Print usage errors as JSON if the arguments contain `--json`."""
    as_json = "--json" in args  # read first, because the parser removes arguments from the list
    try:
        yield
    except Exception as fault:
        if not as_json or not hasattr(fault, "format_message"):
            raise
        code = int(getattr(fault, "exit_code", 2))
        print_error(str(fault.format_message()), "UsageError", code, as_json=True)
        raise typer.Exit(code) from None


class Program(HelpPage):
    """The group of all commands; the help lists them from `command_list`, and each is imported on first use."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = _Commands()

    def listed(self) -> list[tuple[str, Any]]:
        """Return the commands for the help, with their names, without importing them."""
        return [
            (name, TyperCommand(name, help=line.summary, rich_help_panel=line.panel)) for name, line in COMMANDS.items()
        ]

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return list(COMMANDS)


_registered: dict[str, tuple[typer.Typer, str | None]] = {}
"""A dict from name to each imported command or group, which is a separate application for Typer, and its panel."""


class _Commands(Mapping[str, Any]):
    """The commands by name, which are imported and created when they are first requested."""

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            for module in COMMANDS[name].modules.split():
                import_module(f"kinedex.commands.{module}")
            one, panel = _registered[name]
            is_group = one.info.name == name
            self._made[name] = typer.main.get_group(one) if is_group else typer.main.get_command(one)
            self._made[name].rich_help_panel = panel
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


app = typer.Typer(
    name="kinedex",
    cls=Program,
    help="A motion archive that can be queried: motion in, SQL and reports out.",
    epilog="Exit codes: 0 done, 1 failed, 2 usage, 3 some data excluded, 124 too long, 130 by Ctrl-C.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # importing rich takes longer than importing all modules of kinedex that the help needs
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"kinedex {version('kinedex')}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """A motion archive that can be queried: motion in, SQL and reports out."""


class TakesPage(HelpPage):
    """A group whose command `list` runs if the first argument is a store and not the name of a command."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments of the group; if they name no command, insert `list` before them."""
        return super().parse_args(ctx, self.completed(args))

    def completed(self, args: list[str]) -> list[str]:
        """Return the arguments, preceded by `list` if the first one is neither a command nor `--help`."""
        return ["list", *args] if args and args[0] not in self.commands and args[0] != "--help" else args


def group(name: str, title: str, panel: str, cls: type[HelpPage] = HelpPage) -> typer.Typer:
    """Add a group of commands to the application.

    Parameters
    ----------
    name : str
        Name of the group on the command line.
    title : str
        Help of the group.
    panel : str
        Section of the help that lists the group, one of `PANELS`.
    cls : type of HelpPage
        Class of the group.
    """
    made = typer.Typer(name=name, cls=cls, help=title, no_args_is_help=True, rich_markup_mode=None)
    _registered[name] = made, panel
    return made


def command(
    panel: str | None = None, *, of: typer.Typer | None = None, name: str | None = None, cls: type[Command] = Command
) -> Callable[[Function], Function]:
    """Register a function as a command that has the common options and reports its errors in one message.

    Parameters
    ----------
    panel : str or None
        Section of the help that lists the command, one of `PANELS`; None in a group.
    of : typer.Typer or None
        Group of the command; by default none.
    name : str or None
        Name of the command; by default the function's name.
    cls : type of Command
        Class of the command.
    """

    def register(function: Function) -> Function:
        group = typer.Typer(add_completion=False, rich_markup_mode=None) if of is None else of
        group.command(name, cls=cls)(_guarded(function))
        if of is None:
            _registered[name or function.__name__.replace("_", "-")] = group, panel
        return function

    return register


QuietOption = Annotated[bool, typer.Option("--quiet", help="Print results and errors only.")]
VerboseOption = Annotated[bool, typer.Option("--verbose", "-v", help="Print log records to standard error.")]
LogOption = Annotated[
    Path | None, typer.Option("--log-file", metavar="FILE", help="Append log records to this file as JSON lines.")
]
COMMON_OPTIONS = {"quiet": (QuietOption, False), "verbose": (VerboseOption, False), "log_file": (LogOption, None)}
"""The options of every command, as a dict from parameter to its type and default."""

NO_PATHS = ("scheduler", "note")
"""Parameters of commands whose values may be addresses with a scheme, not paths."""


class OptionGroup:
    """Base class for dataclasses of related options, with a field for each option.

    A parameter of a command whose type is such a class, such as `run: RunOptions`, stands for all of its options;
    `run: Annotated[RunOptions, "workers wait"]` stands for the options that are named, in this order.
    """


def _group_of(kind: Any) -> tuple[type[OptionGroup], list[str]] | None:
    """Return the class of a parameter that stands for several options, and their names; None for other parameters."""
    group, *names = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    if not (isinstance(group, type) and issubclass(group, OptionGroup)):
        return None
    return group, names[0].split() if names else [one.name for one in fields(group) if one.init]  # type: ignore[arg-type]


def _unfolded(
    signature: inspect.Signature, groups: dict[str, tuple[type[OptionGroup], list[str]]]
) -> list[inspect.Parameter]:
    """Return the parameters of a command, with groups replaced by their options, and the common options added."""
    parameters: list[inspect.Parameter] = []
    for name, one in signature.parameters.items():
        if name not in groups:
            parameters.append(one)
            continue
        group, options = groups[name]
        kinds = get_type_hints(group, include_extras=True)
        parameters += [
            inspect.Parameter(option, one.kind, default=getattr(group, option), annotation=kinds[option])
            for option in options
        ]
    return parameters + [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (kind, default) in COMMON_OPTIONS.items()
    ]


def _guarded(function: Callable[..., None]) -> Callable[..., None]:
    """Wrap a command: add the common options, and print one message and set the exit code if it fails."""
    signature = inspect.signature(function, eval_str=True)
    found = {name: _group_of(one.annotation) for name, one in signature.parameters.items()}
    groups = {name: group for name, group in found.items() if group is not None}

    @functools.wraps(function)
    def guarded(**arguments: Any) -> None:
        from kinedex.console.logs import configure_logging
        from kinedex.console.terminal import configure_messages
        from kinedex.ops.local_paths import refuse_addresses
        from kinedex.storage.ctrl_c import ctrl_c_in_statements

        quiet, verbose, log_file = (arguments.pop(name) for name in COMMON_OPTIONS)
        as_json = bool(arguments.get("as_json"))
        configure_messages(quiet=quiet, to_stderr=as_json)
        try:
            refuse_addresses([value for name, value in arguments.items() if name not in NO_PATHS])
            refuse_addresses(log_file)
            configure_logging(quiet=quiet, verbose=verbose, log_file=log_file)
            for name, (group, options) in groups.items():
                arguments[name] = group(**{option: arguments.pop(option) for option in options})
            with _logged(function.__name__.replace("_", "-")), ctrl_c_in_statements():
                function(**arguments)
        except KinedexError as fault:
            code = _CODES.get(type(fault).__name__, FAILED)
            print_error(str(fault), type(fault).__name__, code, as_json, fault.remedy)
            raise typer.Exit(code) from None
        except typer.BadParameter as fault:
            if not as_json:
                raise
            print_error(fault.format_message(), "UsageError", fault.exit_code, as_json)
            raise typer.Exit(fault.exit_code) from None
        except KeyboardInterrupt as fault:
            with suppress(ValueError):  # signals can be set in the main thread only
                signal.signal(signal.SIGINT, signal.SIG_IGN)
            message = str(fault) or "stopped; the same command continues where it was"
            print_error(message, "KeyboardInterrupt", INTERRUPTED, as_json)
            raise typer.Exit(INTERRUPTED) from None
        except OSError as fault:
            if _is_closed_pipe(fault):
                # The reader of the pipe has ended, so that nothing can be written to the pipe, not even at exit.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                raise typer.Exit(0) from None
            message = f"{fault.filename}: {fault.strerror}" if fault.filename else str(fault)
            print_error(message, type(fault).__name__, FAILED, as_json)
        except MemoryError:
            print_error("out of memory; fewer --workers need less", "MemoryError", FAILED, as_json)
        else:
            return
        raise typer.Exit(FAILED)

    parameters = _unfolded(signature, groups)
    guarded.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    guarded.__annotations__ = {one.name: one.annotation for one in parameters}
    return guarded


@contextmanager
def _logged(command: str) -> Iterator[None]:
    """Log start, end and errors of a command as events, which are not repeated on standard error."""
    import logging
    import time

    log = logging.getLogger("kinedex.commands")
    begin = time.perf_counter()
    log.info("%s: begins", command, extra={"event": "command", "arguments": sys.argv[1:]})
    try:
        yield
    except (KinedexError, OSError, KeyboardInterrupt) as fault:
        log.error("%s: %s", command, str(fault) or type(fault).__name__, extra={"event": "error"})
        raise
    log.info("%s: done", command, extra={"event": "done", "seconds": round(time.perf_counter() - begin, 3)})


def _is_closed_pipe(fault: OSError) -> bool:
    """Return whether the reader of a pipe has ended, which Windows reports as an invalid argument."""
    return isinstance(fault, BrokenPipeError) or (
        os.name == "nt" and fault.errno == errno.EINVAL and fault.filename is None
    )


def print_error(message: str, kind: str, code: int, as_json: bool, remedy: Remedy | None = None) -> None:
    """Print an error: one message on standard error, or one JSON object on standard output.

    Parameters
    ----------
    message : str
        The message, which states what was found, what was expected, and what to do.
    kind : str
        Class of the error.
    code : int
        Exit code of the command.
    as_json : bool
        Print `{"error": {"type", "message", "exit_code", "remedy"}}`.
    remedy : Remedy, optional
        The remedy, as a command or an action.
    """
    if as_json:
        from kinedex.storage.formats.json_text import json_text

        error = {"type": kind, "message": message, "exit_code": code, "remedy": remedy and asdict(remedy)}
        print(json_text({"error": error}), end="")
    else:
        print(f"kinedex: {visible_lines(message)}", file=sys.stderr)
