"""Draft pipeline files with patterns proposed for an archive, as commented YAML, with takes held out for evaluation."""

from __future__ import annotations

import re
import textwrap
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from kinedex.ops.wording import counted, visible
from kinedex.pipelines.ingestion.pattern_proposal import Proposal, Token

_MAX_HELD_OUT = 0.34
"""The largest fraction of the takes that is held out."""

_VALUES = 5
"""The largest number of values that are held out, so that the filter stays readable."""

_EVERY = 4
"""If there is no column to divide by, each take whose number is divisible by this is held out."""

MAX_VALUES = 12
"""The largest number of values of a token that a comment lists."""

_WIDEST = 110
_STAGES = """
  learn_templates:
    params: {where: "${train}"}
    # mirror: {kickLeft: kickRight}    # the clips of one class, mirrored, are examples of another

  annotate:
    params:
      where: "${annotate}"
      method: "${method}"
      classes: "${classes}"

  evaluate:
    params: {source: "${source}"}
    # ground_truth: "**/*.eaf"    # other label files; unless given, ground_truth.csv if there is one

  report:
"""

_BY_CLASS = """
  evaluate:
    params: {ground_truth: class}    # the class of a take, which its path names, is that of all of its frames
"""

_SETTINGS = """
  classes: own                # every value of `class` its own class; or a file of configs/classes, or a path
  method: best                # or thesis; see docs/accuracy.md
"""

_FILTERS = """
  train: class IS NOT NULL    # takes to learn from: a filter over the columns of `takes`
  annotate: class IS NULL     # takes to annotate
"""


@dataclass(frozen=True)
class Division:
    """SQL filters over the columns of takes that divide an archive in two.

    Attributes
    ----------
    train : str
        The filter of the takes to learn from.
    annotate : str
        The filter of the takes to annotate.
    reason : str
        A description of the values that are held out.
    """

    train: str
    annotate: str
    reason: str


def division(proposals: Sequence[Proposal]) -> Division | None:
    """Divide takes by actor, by clip, or by another column from their paths, so that training has every class.

    Without such a column every fourth take is held out. The result is None if there are too few takes.

    Parameters
    ----------
    proposals : sequence of Proposal
        The patterns of all paths; each of them yields a class.
    """
    columns = [{token.role: token.column.values for token in one.tokens if token.role} for one in proposals]
    shared = [role for role in columns[0] if all(role in one for one in columns) and role != "class"]
    classes = [name for one in columns for name in one["class"]]
    for role in sorted(shared, key=lambda role: {"actor": 0, "clip": 1}.get(role, 2)):
        values = [value for one in columns for value in one[role]]
        held_out = _held_out(classes, values)
        if held_out:
            listed = ", ".join("'" + value.replace("'", "''") + "'" for value in held_out)
            one = len(held_out) == 1
            return Division(
                f"{role} <> {listed}" if one else f"{role} NOT IN ({listed})",
                f"{role} = {listed}" if one else f"{role} IN ({listed})",
                f"the takes of {role} {' and '.join(held_out)}",
            )
    if len(classes) < _EVERY * len(set(classes)):
        return None
    return Division(f"take_id % {_EVERY} <> 0", f"take_id % {_EVERY} = 0", "every fourth take")


def _held_out(classes: Sequence[str], values: Sequence[str]) -> list[str]:
    """Return a few values whose takes cover many classes, while the takes of the other values cover every class.

    The list is empty if less than half of the classes would be evaluated.
    """
    of_value: dict[str, Counter[str]] = defaultdict(Counter)
    for name, value in zip(classes, values, strict=True):
        of_value[value][name] += 1
    of_value.pop("", None)
    left, found, covered = Counter(classes), list[str](), set[str]()
    while len(found) < _VALUES and len(covered) < len(left):
        room = _MAX_HELD_OUT * len(classes) - (len(classes) - left.total())
        fitting = {
            value: len(set(own) - covered)
            for value, own in of_value.items()
            if value not in found and own.total() <= room and all(left[name] > n for name, n in own.items())
        }
        best = max(fitting, key=lambda value: (fitting[value], value), default=None)
        if best is None or not fitting[best]:
            break
        found.append(best)
        covered |= set(of_value[best])
        left -= of_value[best]
    return sorted(found) if 2 * len(covered) >= len(set(classes)) else []


def value_counts(token: Token, most: int) -> str:
    """Return the values of a token with their counts, most frequent first, such as "walk (12), run (3)"."""
    counts = sorted(token.column.counts.items(), key=lambda item: (-item[1], item[0]))
    shown = ", ".join(f"{visible(value) or 'nothing'} ({count:,})" for value, count in counts[:most])
    return shown + (f" and {len(counts) - most:,} more" if len(counts) > most else "")


def draft_pipeline(proposals: Sequence[Proposal], source: Path, count: int, matched: int, output: str) -> str:
    """Return the text of a pipeline file.

    If every take has a class, some takes are held out of training, annotated, and evaluated by their classes. Stages
    that need example clips, or takes to annotate, are commented out if the archive has none.

    Parameters
    ----------
    proposals : sequence of Proposal
        The patterns, in the order in which they are tried.
    source : Path
        The folder, absolute.
    count : int
        The number of its motion files.
    matched : int
        The number of those that a pattern matches.
    output : str
        The path of the file, for the command in its comment.
    """
    # names of pipelines have only these characters
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", source.name).strip("-_") or "archive"
    with_class = sum(len(one.layout.paths) for one in proposals if any(token.role == "class" for token in one.tokens))
    divided = division(proposals) if with_class == count else None
    lines = [
        f"# Proposed by `kinedex init` for {counted(count, 'motion file')} below {visible(str(source))}.",
        "#",
        f"#   kinedex plan {visible(output)} --store my-store",
        f"#   kinedex run {visible(output)} --store my-store",
        "#",
        f"# The patterns match {matched:,} of {counted(count, 'path')}. Rename groups, or take ?P<name> away; what is",
        "# changed later re-reads no file. `actor` is whom evaluations leave out, `class` is what is learned.",
        "",
        f"name: {_scalar(name)}",
        f"description: {_scalar(f'Takes of {source.name}, described by their paths.')}",
        "",
        "settings:",
        f"  source: {_scalar(str(source))}",
        *_SETTINGS.strip("\n").splitlines(),
        *_filters(divided),
        "",
        "stages:",
        "  ingest:",
        "    params:",
        '      source: "${source}"',
        "      # metadata: licences.csv    # a table whose rows name takes, and whose columns become columns of takes",
        *_patterns(proposals),
        "",
        "  index:",
        *_rest(with_class, count, divided),
    ]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _patterns(proposals: Sequence[Proposal]) -> list[str]:
    if not proposals:
        return [
            "      # the names have nothing in common; a group of a pattern is a column, as in '(?P<actor>[^_]+)_'",
            "      patterns: []",
        ]
    lines = ["      patterns:"]
    for proposal in proposals:
        lines.append(
            f"        # {counted(len(proposal.layout.paths), 'path')}, such as {visible(proposal.layout.paths[0])}"
        )
        for token in (token for token in proposal.tokens if token.role):
            number = counted(len(token.column.counts), "value")
            text = f"{token.role} ({token.why}): {number}: {value_counts(token, MAX_VALUES)}"
            begin = "        #   "
            lines += textwrap.wrap(text, _WIDEST, initial_indent=begin, subsequent_indent=f"{begin}  ")
        lines.append(f"        - {_scalar(proposal.pattern)}")
    return lines


def _filters(divided: Division | None) -> list[str]:
    """Return the settings that select the takes to learn from and those to annotate."""
    if divided is None:
        return _FILTERS.strip("\n").splitlines()
    quote = '"'  # the filters contain single quotes
    return [
        f"  # every take has a class: {visible(divided.reason)} are annotated, evaluated by their own classes, and not",
        "  # learned from; once there are takes without a class, write `class IS NOT NULL` and `class IS NULL`",
        f"  train: {_scalar(divided.train, quote)}",
        f"  annotate: {_scalar(divided.annotate, quote)}",
    ]


def _rest(with_class: int, count: int, divided: Division | None) -> list[str]:
    """Return the stages after the index; those that would find no takes are commented out, with the reason."""
    stages = _STAGES.rstrip().splitlines()
    place = stages.index("  evaluate:")
    if divided is not None:
        return [*stages[:place], *_BY_CLASS.strip("\n").splitlines(), *stages[stages.index("", place) :]]
    if 0 < with_class < count:
        return stages
    why = (
        "no token looks like a class: name one ?P<class>, or add example clips"
        if not with_class
        else "every take has a class, and they are too few to hold some out: add takes to annotate"
    )
    learn = stages.index("") + 1
    first = stages[:0] if not with_class else stages[learn - 1 : stages.index("", learn)]
    # comments within commented-out stages are removed
    others = [line for line in stages[len(first) :] if not line.lstrip().startswith("#")]
    return [
        *first,
        "",
        f"  # {why}; then take the # away:",
        *(f"  # {line[2:]}" if line else "  #" for line in others[1:]),
    ]


def _scalar(text: str, quote: str = "'") -> str:
    """Return a text as a YAML scalar on one line."""
    return yaml.safe_dump(text, default_style=quote, width=10**9, allow_unicode=True).strip()
