"""Find the static trial that stands beside a file of markers, by the names of both."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from itertools import groupby

from kinedex.catalog.capture_sessions import MARKERS
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.skeleton_files import name_parts

_STATIC = frozenset(
    "static statics statik statique statisch estatico estatica statica cal calib calibration tpose apose npose".split()
)
_LETTERS = frozenset("tan")  # T-pose, A-pose, N-pose
_ANY = frozenset(("trial", "pose"))  # words beside these that name no subject


def subject_parts(stem: str) -> list[tuple[str, ...]] | None:
    """Return the parts of a static trial's name before and after its word for static; None if it has no such word.

    Numbers behind the word count its trials, and are no part of a subject's name.

    Examples
    --------
    >>> subject_parts("subject01_Static2")
    [('subject', '01')]
    >>> subject_parts("walk_1") is None
    True
    """
    parts = list(name_parts(stem))
    for i in range(len(parts) - 1, 0, -1):
        if parts[i] == "pose" and parts[i - 1] in _LETTERS:
            parts[i - 1 : i + 1] = [f"{parts[i - 1]}pose"]
    if _STATIC.isdisjoint(parts):
        return None
    groups, counts = [], False
    for is_word, those in groupby(parts, key=lambda part: part in _STATIC or part in _ANY):
        named = tuple(those)
        if not is_word:
            named = named[1:] if counts and named[0].isdigit() else named
            groups += [named] if named else []
        counts = is_word
    return groups


def trials_by_folder(files: Iterable[SourceFile]) -> Mapping[tuple[str, str], list[SourceFile]]:
    """Return the static trials by folder and format, sorted by path."""
    found: dict[tuple[str, str], list[SourceFile]] = {}
    for file in sorted(files, key=lambda file: file.path):
        if file.format in MARKERS and subject_parts(file.stem) is not None:
            found.setdefault((os.path.dirname(file.path), file.format), []).append(file)
    return found


def static_trial_of(motion: SourceFile, trials: Mapping[tuple[str, str], list[SourceFile]]) -> SourceFile | None:
    """Return the static trial of a motion; None if it has none, or is one itself.

    It stands in the same folder, has the same format, and its name has a word such as "static". What else is in
    its name stands in the motion's as well: `subject01_static.c3d` serves `subject01_walk2.c3d`, and
    `static.c3d` all of the folder. Of several the one with the longest such name counts, then the first one.

    Parameters
    ----------
    motion : SourceFile
        The motion.
    trials : mapping
        Folder and format → static trials, as of `trials_by_folder`.
    """
    beside = trials.get((os.path.dirname(motion.path), motion.format), [])
    if not beside or subject_parts(motion.stem) is not None:
        return None
    own = name_parts(motion.stem)
    groups = {trial: subject_parts(trial.stem) or [] for trial in beside}
    fitting = [trial for trial in beside if all(_holds(own, group) for group in groups[trial])]
    return max(fitting, key=lambda trial: sum(map(len, groups[trial])), default=None)


def _holds(parts: tuple[str, ...], group: tuple[str, ...]) -> bool:
    return any(parts[i : i + len(group)] == group for i in range(len(parts) - len(group) + 1))
