"""The command line: `kinedex COMMAND`."""

from __future__ import annotations

from kinedex.pipelines.commands import keyframes, labels, queries, ranking, reports, templates
from kinedex.pipelines.commands import maintenance as keeping
from kinedex.pipelines.commands import pipelines as running
from kinedex.pipelines.commands import tables as exploring
from kinedex.pipelines.commands.shell import app

PANELS = {
    running: "Run pipelines",
    reports: "Run pipelines",
    exploring: "Ask a store",
    templates: "Ask a store",
    labels: "Ask a store",
    queries: "Search for motion",
    ranking: "Search for motion",
    keyframes: "Search for motion",
    keeping: "Look after files and stores",
}
"""The modules whose commands the app has (importing one registers them), in the order of the help, and their titles."""

_TITLES = {module.__name__: title for module, title in PANELS.items()}
for _command in app.registered_commands:
    _command.rich_help_panel = _TITLES[getattr(_command.callback, "__module__", "")]
app.registered_commands.sort(key=lambda one: list(_TITLES.values()).index(str(one.rich_help_panel)))


def main() -> None:
    """The console command `kinedex`."""
    app(prog_name="kinedex")  # by whatever file it was started


if __name__ == "__main__":
    main()
