"""Choose the format of label files by their extensions, read and write the labels of takes, and find ground truth."""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.ops.errors import KinedexError, SourceError, did_you_mean
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.labels import audacity, elan, label_tables, webvtt
from kinedex.storage.formats.labels.file_labels import ERROR, Label, LabelFile, LabelsOfTake, is_writable
from kinedex.storage.formats.labels.file_labels import ManualSegment as ManualSegment
from kinedex.storage.formats.labels.label_tables import COLUMNS

_RESERVED = re.compile(r"(?:con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(?:\..*)?", re.IGNORECASE)
_FORBIDDEN = frozenset('/\\:*?"<>|')
_INVISIBLE = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
_MAX_BYTES = 180


def file_names(takes: Sequence[str]) -> list[str]:
    """Return a file name without its extension for each take: the take's name if it is valid on every system.

    Characters that are invisible or forbidden on some system become underscores. A tilde and eight digits of a checksum
    are appended to a name that was changed, or that differs from the name of another take only in case.
    """
    used: set[str] = set()
    names = []
    for take in takes:
        name = _safe(take)
        if name != take or _key(name) in used:
            name = f"{name}~{hashlib.sha256(take.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"
        used.add(_key(name))
        names.append(name)
    return names


def _safe(take: str) -> str:
    name = "".join("_" if one in _FORBIDDEN or unicodedata.category(one) in _INVISIBLE else one for one in take)
    name = name.encode()[:_MAX_BYTES].decode(errors="ignore").strip(" ").rstrip(". ")
    return f"{name}_" if not name or _RESERVED.fullmatch(name) else name


def _key(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


@dataclass(frozen=True)
class Format:
    """A format of label files.

    Attributes
    ----------
    title : str
        Name of the format for users.
    write : callable
        Returns the text of a file with the labels of takes.
    read : callable
        Reads the labels of a file.
    several : bool
        True if one file can hold several takes; names in such files may contain control characters.
    limbs : str
        The labels whose limb the format can store: "all", "errors" (those of the class `error`) or "none".
    """

    title: str
    write: Callable[[Sequence[LabelsOfTake]], str]
    read: Callable[[str | Path], LabelFile]
    several: bool = False
    limbs: Literal["all", "errors", "none"] = "none"


def _of_one(write: Callable[[LabelsOfTake], str]) -> Callable[[Sequence[LabelsOfTake]], str]:
    def write_one(takes: Sequence[LabelsOfTake]) -> str:
        (labels,) = takes
        return write(labels)

    return write_one


FORMATS: dict[str, Format] = {
    "csv": Format("CSV", label_tables.write_csv, label_tables.read_csv, several=True, limbs="all"),
    "json": Format("JSON", label_tables.write_json, label_tables.read_json, several=True, limbs="all"),
    "eaf": Format("ELAN", _of_one(elan.write), elan.read, limbs="errors"),
    "vtt": Format("WebVTT", _of_one(webvtt.write), webvtt.read),
    "txt": Format("Audacity labels", _of_one(audacity.write), audacity.read),
}
"""A dict from file extension to format."""

ENDINGS = ", ".join(f".{name} ({form.title})" for name, form in FORMATS.items())


@dataclass(frozen=True)
class Written:
    """The label files that a call has written.

    Attributes
    ----------
    paths : tuple of Path
        The files, each of them complete.
    renamed : dict of str to str
        Take → name of its file, if the take's own name is not a valid file name.
    excluded : tuple of str
        Takes that the format cannot store, since their names or those of their classes would be read back differently.
    """

    paths: tuple[Path, ...]
    renamed: dict[str, str]
    excluded: tuple[str, ...]


def read_labels(path: str | Path) -> LabelFile:
    """Read takes and their manual segments from a label file; its extension determines the format.

    In a format without names of takes, the name of the file is that of the take. Intervals are half-open; frames are
    those of the source file, from 0. Seconds become the nearest source frame once the rate of the take is known
    (`ManualSegment.source_frames`).

    Raises
    ------
    SourceError
        The extension is unknown, or the file is damaged; the error names the line.
    """
    ending = Path(path).suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        raise SourceError(path, f"is not read as labels: the ending must be one of {ENDINGS}")
    return FORMATS[ending].read(path)


def write_labels(
    takes: Sequence[LabelsOfTake], form: str | None, output: str | Path, *, force: bool = False
) -> Written:
    """Write the labels of takes, to a folder with a file for each take, or to one file.

    Parameters
    ----------
    takes : sequence of LabelsOfTake
        The labels.
    form : str or None
        A key of `FORMATS`, in upper or lower case; None for the format of the file's extension, CSV for a folder.
    output : str or Path
        A file or a folder. A path is a file if it has an extension of the format; it is a folder if it has another
        ending, ends in a slash, or is an existing folder. Missing folders are created, and the files in a folder are
        named after the takes, as far as `file_names` allows.
    force : bool, optional
        Replace existing files.

    Returns
    -------
    Written
        The files, and the takes that were renamed or excluded.

    Raises
    ------
    KinedexError
        The format is unknown; files exist already, in which case none is written; several takes are to be written to a
        file whose format stores one take; the format can store none of the takes, or cannot store the limb of a label;
        or a file cannot be written.
    """
    folder = str(output).endswith("/") or os.path.isdir(output)
    kind = _format(form, output, folder)
    _refuse_limbs(takes, kind)
    writable = [labels for labels in takes if is_writable(labels, quoted=FORMATS[kind].several)]
    inside = {labels.take for labels in writable}
    excluded = tuple(labels.take for labels in takes if labels.take not in inside)
    if excluded and not writable:
        raise KinedexError(
            f"a file of {FORMATS[kind].title} cannot hold {excluded[0]!r}: the name of the take or of a class would "
            "be read back differently; a name must not be empty, begin or end with a space, or (except in CSV and "
            "JSON) contain control characters"
        )
    writable = _with_limbs(writable) if FORMATS[kind].limbs == "errors" else writable
    targets = _targets(writable, kind, Path(output), folder)
    standing = []
    for path in targets:
        with _writing(path):
            standing += [path] if path.exists() else []
    if standing and not force:
        more = f" and {len(standing) - 1} more" if len(standing) > 1 else ""
        raise KinedexError(f"{standing[0]}{more}: there already; nothing is overwritten without --force")
    for path, members in targets.items():
        text = FORMATS[kind].write(members)
        with _writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as temporary:
                temporary.write_text(text, encoding="utf-8", newline="")
    own = {} if Path(output) in targets else {members[0].take: path.name for path, members in targets.items()}
    renamed = {take: name for take, name in own.items() if name != f"{take}.{kind}"}
    return Written(tuple(targets), renamed, excluded)


def _with_limbs(takes: Sequence[LabelsOfTake]) -> list[LabelsOfTake]:
    """Return labels in which annotators who examined whole takes are listed for each limb that any label mentions."""
    limbs = {one.limb for labels in takes for one in labels.labels if one.label == ERROR}
    limbs |= {limb for labels in takes for limb, _ in labels.covered}
    return [
        replace(
            labels,
            covered=tuple(
                (limb, annotator)
                for own, annotator in labels.covered
                for limb in ([own] if own else sorted(limbs - {""}))
            ),
        )
        for labels in takes
    ]


def _refuse_limbs(takes: Sequence[LabelsOfTake], kind: str) -> None:
    form = FORMATS[kind]
    for labels in takes:
        for one in labels.labels:
            if one.limb and not _has_place(form, one):
                raise KinedexError(
                    f"{form.title} has no place for the limb of a label '{one.label}' ({labels.take}, {one.limb}); "
                    f"use csv or json{', or eaf' if _has_place(FORMATS['eaf'], one) else ''}"
                )
        if labels.covered and form.limbs == "none":
            raise KinedexError(
                f"{form.title} has no place for limbs that were looked at without an error being found "
                f"({labels.take}); use csv, json or eaf"
            )


def _has_place(form: Format, one: Label) -> bool:
    is_error = one.label == ERROR and one.limb in LIMB_NAMES
    return form.limbs == "all" or (form.limbs == "errors" and is_error)


def _format(form: str | None, output: str | Path, folder: bool) -> str:
    ending = Path(output).suffix.lower().removeprefix(".")
    if form is not None:
        if form.lower() not in FORMATS:
            raise KinedexError(f"no format of labels is named '{form}'{did_you_mean(form, FORMATS)}")
        return form.lower()
    if folder or not ending:
        return "csv"
    if ending not in FORMATS:
        raise KinedexError(
            f"{output}: its ending, '.{ending}', is no format of labels{did_you_mean(ending, FORMATS)}; for a folder "
            "of this name give --format, or put a / at its end"
        )
    return ending


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Convert an operating system's error to a KinedexError that names the file and the cause."""
    try:
        yield
    except OSError as fault:
        other = next((one for one in path.parents if one.exists() and not one.is_dir()), None)
        if other is not None:
            raise KinedexError(f"{other}: is no folder, so {path.name} cannot be written into it") from None
        raise KinedexError(f"{path}: cannot be written: {fault.strerror}") from None


def _targets(
    takes: Sequence[LabelsOfTake], form: str, output: Path, folder: bool
) -> dict[Path, Sequence[LabelsOfTake]]:
    if output.suffix.lower() == f".{form}" and not folder:
        if len(takes) != 1 and not FORMATS[form].several:
            title = FORMATS[form].title
            raise KinedexError(f"{output}: a file of {title} holds one take, not {len(takes)}; name a folder")
        return {output: takes}
    names = file_names([labels.take for labels in takes])
    return {output / f"{name}.{form}": (labels,) for name, labels in zip(names, takes, strict=True)}


def ground_truth_files(pattern: str, roots: Iterable[str | Path]) -> list[Path]:
    """Find the label files of a pattern, sorted.

    Parameters
    ----------
    pattern : str
        A glob relative to each source root, such as "**/ground_truth.csv", or an absolute path or glob.
    roots : iterable of str or Path
        The folders that the archive's takes come from.

    Raises
    ------
    KinedexError
        There is no such file, or a root does not exist; the message names the folders that were searched.
    """
    folders, below = _places(pattern, roots)
    found = _found(folders, below)
    if not found:
        raise KinedexError(
            f"ground truth: no file '{below}' below {', '.join(map(str, folders)) or 'any source folder'}. "
            f"It is a CSV file with the columns {', '.join(COLUMNS)} (source frames, half-open), or labels of another "
            f"kind: {ENDINGS}; where there is none, set `ground_truth` of this stage to none, as with "
            "`--set evaluate.ground_truth=none` for the stage evaluate"
        )
    return found


def any_ground_truth(pattern: str, roots: Iterable[str | Path]) -> bool:
    """Return whether a pattern finds label files; parameters and errors are those of `ground_truth_files`."""
    return bool(_found(*_places(pattern, roots)))


def _places(pattern: str, roots: Iterable[str | Path]) -> tuple[list[Path], str]:
    """Return the folders to search, and the glob relative to them."""
    path = Path(pattern).expanduser()
    if path.is_absolute():
        return [Path(path.anchor)], str(path.relative_to(path.anchor))
    return [Path(root).expanduser() for root in roots], pattern


def _found(folders: Sequence[Path], pattern: str) -> list[Path]:
    gone = [str(folder) for folder in folders if not folder.is_dir()]
    if gone:
        raise KinedexError(f"ground truth: the source folder {gone[0]} is no longer there; give an absolute path")
    try:
        return sorted({file for folder in folders for file in folder.glob(pattern) if file.is_file()})
    except (ValueError, OSError) as fault:
        raise KinedexError(f"ground truth: '{pattern}' does not work as a path or glob: {fault}") from None
