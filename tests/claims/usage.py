"""Compares the words of a command with the commands and options that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import typer

from kinedex.commands.cli import app

ROOT = Path(__file__).resolve().parents[2]


def wrong_usage(line: str) -> str:
    """Return what is wrong with a command of kinedex or a study: a command or an option that is not there, or nothing.

    Parameters
    ----------
    line : str
        The command; where it stands in a sentence, … and [OPTION] may stand for more.
    """
    if study := re.match(r"python -m (studies|benchmarks)\.(\w+)(.*)", line, re.DOTALL):
        return _wrong_program(ROOT / study[1] / f"{study[2]}.py", study[3])
    if not line.startswith("kinedex"):
        return ""
    words = shlex.split(re.sub(r"[\[\]]", " ", line) if "[-" in line else line, comments=True)[1:]
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        words = command.completed(words) if hasattr(command, "completed") else words
        if not words or words[0].startswith(("-", "…")):
            break
        if words[0] not in command.commands:
            return f"no command {words[0]}"
        command = command.commands[words.pop(0)]
    known = {option for parameter in command.params for option in parameter.opts} | {"--help", "--version"}
    options = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
    return f"no option {', '.join(sorted(options - known))}" if options - known else ""


def _wrong_program(file: Path, rest: str) -> str:
    """Return what is wrong with the arguments of a study or a benchmark."""
    if not file.is_file():
        return f"no program {file.stem}"
    text = file.read_text(encoding="utf-8")
    unknown = [option for option in re.findall(r"(?<!\S)--[a-z][\w-]*", rest) if f'"{option}"' not in text]
    return f"no option {', '.join(unknown)}" if unknown else ""
