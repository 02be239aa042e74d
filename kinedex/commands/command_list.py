"""List the commands of `kinedex` in the order of the help, with first lines and the modules that define them.

The help is printed from this list, and a command is imported only when it is requested, so that a process loads one
command. Tests compare the first lines with those of the commands themselves.
"""

from __future__ import annotations

from typing import NamedTuple

RUN, ASK, SEARCH = "Run pipelines", "Ask a store", "Search for motion"
TRACK, MAINTAIN = "Track bodies", "Look after files and stores"
PANELS = (RUN, ASK, SEARCH, TRACK, MAINTAIN)
"""The groups of commands in the order of the help, which begins with what most people need first."""


class Listed(NamedTuple):
    """A line of the help.

    Attributes
    ----------
    panel : str
        The group of commands, one of `PANELS`.
    modules : str
        Modules of `kinedex.commands`, separated by blanks, whose import registers the command, or all
        commands of a group in the order of its help.
    summary : str
        The first line of the command's help.
    """

    panel: str
    modules: str
    summary: str


COMMANDS = {
    "init": Listed(RUN, "pipelines", "Propose patterns for the names of motion files, as a pipeline."),
    "demo": Listed(RUN, "pipelines", "Run everything, from motion files to a report."),
    "run": Listed(RUN, "pipelines", "Run the stages of a pipeline that are not up to date."),
    "plan": Listed(RUN, "pipelines", "Show which stages `run` would run, and why."),
    "ingest": Listed(RUN, "pipelines", "Read motion files into a store and index them."),
    "synth": Listed(RUN, "pipelines", "Make a synthetic archive of ASF/AMC files with ground truth."),
    "report": Listed(RUN, "pipelines", "Compare evaluations."),
    "sql": Listed(ASK, "tables", "Ask the store in SQL (DuckDB), read-only."),
    "explore": Listed(ASK, "tables", "Open the archive in a browser: takes, search by example, labels."),
    "export": Listed(ASK, "export", "Write takes, or clips cut out of them, as files."),
    "takes": Listed(ASK, "tables store_changes", "List the takes of a store: `kinedex takes STORE`; remove some."),
    "labels": Listed(ASK, "labels", "Keep the labels of people; write and read label files."),
    "explain": Listed(ASK, "explanations", "Explain which class an interval of a take shows, by quantities."),
    "template": Listed(ASK, "ranking", "Show, compare and make motion templates."),
    "search": Listed(SEARCH, "queries", "Search for keyframe queries with the index."),
    "rank": Listed(SEARCH, "ranking", "Rank the intervals of an archive by templates, or by an example."),
    "keyframes": Listed(SEARCH, "queries", "Learn keyframe queries from example clips."),
    "query": Listed(SEARCH, "queries", "Make keyframe queries."),
    "reconstruct": Listed(TRACK, "tracking", "Make takes of recordings by a depth camera."),
    "track": Listed(TRACK, "tracking", "Make takes of recordings by calibrated cameras."),
    "stabilise": Listed(TRACK, "tracking", "Stabilise tracked takes by what the archive knows."),
    "simulate": Listed(TRACK, "simulate", "Make recordings of takes, with their truth apart."),
    "use": Listed(MAINTAIN, "store_changes", "Choose the pipeline whose results the views show, or list them."),
    "merge": Listed(MAINTAIN, "store_changes", "Add the takes and labels of another store to a store."),
    "duplicates": Listed(MAINTAIN, "maintenance", "List takes that come from the same file or show the same motion."),
    "inspect": Listed(MAINTAIN, "maintenance", "Show what a motion file, sensor file or depth image holds."),
    "verify": Listed(MAINTAIN, "maintenance", "Check the files of a store against its manifest, and the index."),
    "repair": Listed(MAINTAIN, "maintenance", "Repair the damaged files of a store."),
    "upgrade": Listed(MAINTAIN, "maintenance", "Convert a store of an older format."),
    "versions": Listed(MAINTAIN, "maintenance", "List the versions of a store and what each changed."),
    "gc": Listed(MAINTAIN, "maintenance", "Remove old versions of a store."),
    "version": Listed(MAINTAIN, "maintenance", "Print the versions of kinedex and its libraries, and its path."),
    "history": Listed(MAINTAIN, "history", "List, show and repeat what pipelines did to a store."),
    "mapping": Listed(MAINTAIN, "mappings", "Make skeleton mappings, and keep them in a store."),
}
"""A dict from name to the line of the help; a test names lines that are missing or differ."""
