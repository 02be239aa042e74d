"""The formats of label files by their endings: which there are, writing takes, reading ground truth."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ops.errors import KinedexError, SourceError, did_you_mean
from storage.labels import audacity, elan, tables, webvtt
from storage.labels.segments import LabelFile, TakeLabels, check_writable


@dataclass(frozen=True)
class Format:
    """A format of label files: how the labels of takes become a text, what a file says, and whether one
    file holds several takes."""

    title: str
    write: Callable[[Sequence[TakeLabels]], str]
    read: Callable[[str | Path], LabelFile]
    several: bool = False


def _of_one(write: Callable[[TakeLabels], str]) -> Callable[[Sequence[TakeLabels]], str]:
    def write_one(takes: Sequence[TakeLabels]) -> str:
        (labels,) = takes
        return write(labels)

    return write_one


FORMATS: dict[str, Format] = {
    "csv": Format("CSV", tables.write_csv, tables.read_csv, several=True),
    "json": Format("JSON", tables.write_json, tables.read_json, several=True),
    "eaf": Format("ELAN", _of_one(elan.write), elan.read),
    "vtt": Format("WebVTT", _of_one(webvtt.write), webvtt.read),
    "txt": Format("Audacity labels", _of_one(audacity.write), audacity.read),
}
"""File ending → format."""

ENDINGS = ", ".join(f".{name} ({form.title})" for name, form in FORMATS.items())


def read_labels(path: str | Path) -> LabelFile:
    """Read a label file in the format that its ending says.

    Raises
    ------
    SourceError: an unknown ending; or file and line of what is not as the format has it.
    """
    ending = Path(path).suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        raise SourceError(path, f"is not read as labels: the ending must be one of {ENDINGS}")
    return FORMATS[ending].read(path)


def write_labels(takes: Sequence[TakeLabels], form: str, output: Path, *, force: bool = False) -> list[Path]:
    """Write the labels of takes: a file for each into a folder, or one file.

    Parameters
    ----------
    form: a key of `FORMATS`. output: a file where its name ends as the format's do, else a folder, made where missing;
        the files in it bear the takes' names. force: put new files in the place of old ones.

    Returns
    -------
    The files, each of them whole.

    Raises
    ------
    KinedexError: an unknown format, files that are there already (none is written then), several takes for one file of
        a format that holds one, or a name that cannot be written.
    """
    if form not in FORMATS:
        raise KinedexError(f"no format of labels is named '{form}'{did_you_mean(form, FORMATS)}")
    for labels in takes:
        check_writable(labels)
    targets = _targets(takes, form, output)
    standing = [path for path in targets if path.exists()]
    if standing and not force:
        more = f" and {len(standing) - 1} more" if len(standing) > 1 else ""
        raise KinedexError(f"{standing[0]}{more}: there already; nothing is overwritten without --force")
    for path, members in targets.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_whole(path, FORMATS[form].write(members))
    return list(targets)


def _targets(takes: Sequence[TakeLabels], form: str, output: Path) -> dict[Path, Sequence[TakeLabels]]:
    if output.suffix.lower() == f".{form}" and not output.is_dir():
        if len(takes) != 1 and not FORMATS[form].several:
            title = FORMATS[form].title
            raise KinedexError(f"{output}: a file of {title} holds one take, not {len(takes)}; name a folder")
        return {output: takes}
    targets: dict[Path, Sequence[TakeLabels]] = {}
    for labels in takes:
        if labels.take in (".", "..") or any(mark in labels.take for mark in "/\0"):
            raise KinedexError(f"take '{labels.take}' cannot be the name of a file; export it to a file that you name")
        targets[output / f"{labels.take}.{form}"] = (labels,)
    return targets


def _write_whole(path: Path, text: str) -> None:
    handle, temporary = tempfile.mkstemp(prefix=".tmp-", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            file.write(text)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
