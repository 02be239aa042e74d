"""The help lists commands without importing them, and says of each what the command says itself."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import typer

from kinedex.commands import command_list
from kinedex.commands.cli import app
from kinedex.commands.command_list import COMMANDS, PANELS

FOLDER = Path(str(command_list.__file__)).parent
NO_COMMANDS = {
    *("__init__", "app", "cli", "command_list", "options", "output", "pages"),
    *("demo", "live_depth"),
}
"""Modules of the folder that register no command."""


def test_every_line_of_the_help_is_that_of_its_command() -> None:
    root: Any = typer.main.get_command(app)
    for (name, line), shown in zip(COMMANDS.items(), root.listed(), strict=True):
        made = root.commands[name]
        assert made.name == name
        assert line.panel == made.rich_help_panel, f"'{name}' is registered in '{made.rich_help_panel}'"
        for width in (45, 62, 200):
            text = made.get_short_help_str(width)
            assert shown[1].get_short_help_str(width) == text, f"the first line of '{name}' is now: {text}"
    assert [PANELS.index(line.panel) for line in COMMANDS.values()] == sorted(
        PANELS.index(line.panel) for line in COMMANDS.values()
    )


def test_every_module_that_registers_commands_is_listed() -> None:
    listed = {module for line in COMMANDS.values() for module in line.modules.split()}
    assert listed == {path.stem for path in FOLDER.glob("*.py")} - NO_COMMANDS
    for path in FOLDER.glob("*.py"):
        registers = "\n@command(" in path.read_text(encoding="utf-8")
        assert registers == (path.stem in listed), f"{path.name}: list its commands in command_list.py"


def test_the_help_imports_no_command_and_a_command_no_other() -> None:
    def imported(*words: str) -> set[str]:
        code = (
            f"import sys\nsys.argv = ['kinedex', *{list(words)!r}]\nfrom kinedex.commands.cli import main\n"
            "try:\n    main()\nexcept SystemExit:\n    pass\n"
            "print(*(name for name in sys.modules if name.startswith('kinedex.commands.')), file=sys.stderr)"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
        return {name.removeprefix("kinedex.commands.") for name in done.stderr.split()}

    assert imported("--help") == {"app", "cli", "command_list"}
    assert "ranking" in imported("rank", "--help")
    assert "queries" not in imported("rank", "--help")
