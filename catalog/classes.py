"""Read class files, which group the subclasses (labels of training clips) of an archive into classes for annotation.

For the priors of Chapter 6 of the thesis, class files also name the classes in which the body moves forwards, and edit
the marked regions of templates.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import BaseModel, ConfigDict, model_validator

from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.ops.errors import ConfigError, did_you_mean
from kinedex.ops.priors.constraints import Constraint, MarkEdit, Side

OWN = "own"
"""The name to use instead of a class file if every subclass is to be its own class."""


@dataclass(frozen=True)
class MotionClass:
    """A class of motions.

    Attributes
    ----------
    name, description : str
        The name and the description of the class.
    subclasses : tuple of str
        The names of its subclasses.
    locomotion : bool
        True if the body moves forwards in this class, so that a fast foot can be assumed to move forwards too.
    marks : tuple of MarkEdit
        Edits of the marked regions of its templates (thesis, Section 6.4.1).
    """

    name: str
    description: str
    subclasses: tuple[str, ...]
    locomotion: bool = False
    marks: tuple[MarkEdit, ...] = ()


@dataclass(frozen=True)
class Classes:
    """The classes of an annotation, in the order of their labels; of classes with equal costs, the first is chosen.

    Attributes
    ----------
    without_class : tuple of str
        Subclasses of the archive that belong to no class; they are not annotated.
    """

    classes: tuple[MotionClass, ...]
    without_class: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the classes, in order."""
        return tuple(motion_class.name for motion_class in self.classes)

    def of_subclass(self) -> dict[str, str]:
        """Return a dict from subclass to the name of its class."""
        return {subclass: one.name for one in self.classes for subclass in one.subclasses}

    def class_of(self, label: str) -> str | None:
        """Return the class that a label names directly or through a subclass; None if the label is unknown."""
        return self._meaning.get(label)

    @cached_property
    def _meaning(self) -> dict[str, str]:
        # A class takes precedence over a subclass of the same name.
        return self.of_subclass() | {name: name for name in self.names}


class _MarkEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    constraint: Constraint
    side: Side | None = None
    columns: tuple[int, int] | None = None
    remove: bool = False
    name: str = ""

    @model_validator(mode="after")
    def _ordered(self) -> _MarkEntry:
        if self.columns is not None and not 0 <= self.columns[0] <= self.columns[1]:
            raise ValueError(f"columns must be the first and the last one, from 0, got {list(self.columns)}")
        if self.name and self.remove:
            raise ValueError("a region that is removed has no name; take out `name` or `remove`")
        return self


class _ClassEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    description: str = ""
    subclasses: list[str] = []
    locomotion: bool = False
    marks: list[_MarkEntry] = []


def class_files(classes: str | Path) -> list[Path]:
    """Return the files that `load_classes` reads: one file, or no file for "own"."""
    return [] if classes == OWN else [config_path("classes", classes)]


def load_classes(name_or_path: str | Path, subclasses: Iterable[str]) -> Classes:
    """Sort the subclasses of an archive into the classes of a file.

    Parameters
    ----------
    name_or_path : path
        "own", a shipped file of `configs/classes`, or a path to a .yaml file. The file maps each class to a description
        and to subclasses, given by name or by patterns with * ? [ ]; for priors also to `locomotion` and `marks`.
    subclasses : iterable of str
        All subclasses of the archive. A pattern may match any number of them; a class without a match is kept.

    Raises
    ------
    ConfigError
        If a subclass is unknown or is in two classes, or an entry is invalid; the message names file and line.
    """
    known = sorted(set(subclasses))
    if str(name_or_path) == OWN:
        return Classes(tuple(MotionClass(name, "", (name,)) for name in known))
    try:
        path = config_path("classes", name_or_path)
    except ConfigError as fault:
        raise ConfigError(
            name_or_path, f"{fault.reason}; or use '{OWN}', which makes every subclass a class of its own"
        ) from None
    located = load_yaml(path)
    entries = {
        str(name): located.model(_ClassEntry, name, data=entry if isinstance(entry, dict) else {"subclasses": entry})
        for name, entry in located.mapping().items()
    }
    owner: dict[str, tuple[str, int | None]] = {}
    classes = []
    for name, entry in entries.items():
        if not entry.subclasses:
            raise located.error("a class needs `subclasses`: a list of names or patterns", name)
        taken = []
        for place, pattern in enumerate(entry.subclasses):
            key = (name, "subclasses", place)
            for subclass in _matching(located, key, pattern, known):
                other, line = owner.setdefault(subclass, (name, located.line(*key)))
                if other != name:
                    raise located.error(
                        f"subclass '{subclass}' is in class '{other}' already (line {line}); take it out of one", *key
                    )
                taken.append(subclass)
        marks = tuple(
            MarkEdit(**mark.model_dump(), where=f"{path}:{located.line(name, 'marks', place)}: {name}")
            for place, mark in enumerate(entry.marks)
        )
        classes.append(MotionClass(name, entry.description, tuple(dict.fromkeys(taken)), entry.locomotion, marks))
    return Classes(tuple(classes), tuple(name for name in known if name not in owner))


def _matching(located: Located, key: tuple[str | int, ...], pattern: str, known: list[str]) -> list[str]:
    """Return the known subclasses that an entry denotes; a plain name must exist, but a pattern may match nothing."""
    if any(character in pattern for character in "*?["):
        return [name for name in known if fnmatch.fnmatchcase(name, pattern)]
    if pattern not in known:
        raise located.error(f"the archive has no subclass '{pattern}'{did_you_mean(pattern, known)}", *key)
    return [pattern]
