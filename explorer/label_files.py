"""Preview label files as differences from the existing labels, import them, and export labels for other tools.

`POST /api/labels/read {paths: [path], corrects?: "annotations" or "labels", stage?}` shows what would be recorded, and
records nothing; its `checksum` is that of the files. `POST /api/labels/import` with the same and this checksum records
it, unless a file has changed since. `POST /api/labels/export {what: "annotations" or "labels", folder, format, …}`
writes a file for each take.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from kinedex.explorer.answers import command_line
from kinedex.explorer.endpoints import RequestBody, post
from kinedex.ops.errors import ConflictError, KinedexError
from kinedex.ops.local_paths import refuse_addresses
from kinedex.pipelines.annotation.annotation_tables import annotation_stage
from kinedex.pipelines.labels.decisions import (
    counts_of,
    import_labels,
    new_rows,
    proposed_labels,
)
from kinedex.pipelines.labels.label_files import annotation_labels, label_files, stored_labels
from kinedex.storage.formats.labels.file_labels import LabelFile
from kinedex.storage.formats.labels.formats import FORMATS, write_labels

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.open_archive import Archive

Row = dict[str, Any]

MAX_ROWS = 2000
"""Maximum number of rows of an answer; the numbers count all of them."""

Place = Annotated[str, Field(min_length=1, max_length=4000)]


class FilesRequest(RequestBody):
    """A request to preview label files."""

    paths: Annotated[tuple[Place, ...], Field(min_length=1, max_length=100)]
    corrects: Literal["annotations", "labels"] | None = None
    stage: str | None = None


class ImportRequest(FilesRequest):
    """Files to import, with the checksum that they had when they were read."""

    checksum: str
    annotator: Annotated[str, Field(max_length=200)] | None = None


def read_files(archive: Archive, asked: FilesRequest, _request: Request) -> Row:
    """Return the changes to labels that an import of the files would make, without recording them."""
    store = archive.store()
    files, checksum = _files(asked)
    proposed = proposed_labels(store, files, asked.corrects, asked.stage)
    rows, known = new_rows(store, proposed.rows)
    standing = {row["id"]: row for row in store.labels().to_pylist()}

    def difference(row: Row) -> Row:
        """Return a row that would be recorded, with the label that it would replace."""
        before = standing.get(row["replaces"] or "")
        was = before and {key: before[key] for key in ("class", "start", "stop", "verdict")}
        keys = ("take", "class", "start", "stop", "verdict", "origin", "source")
        return {key: row[key] for key in keys} | {"before": was}

    return {
        "checksum": checksum,
        "files": [file.path for file in files],
        "known": known,
        "counts": counts_of(rows),
        "remarks": list(proposed.remarks),
        "total": len(rows),
        "rows": [difference(row) for row in rows[:MAX_ROWS]],
        "command": _command(archive, asked, None),
    }


def import_files(archive: Archive, asked: ImportRequest, _request: Request) -> Row:
    """Record the labels of files, provided that the files have not changed since `read_files`."""
    store = archive.store()
    files, checksum = _files(asked)
    if checksum != asked.checksum:
        raise ConflictError("a file has changed since its differences were shown; read the files again")
    annotator = (asked.annotator or "").strip() or None
    done = import_labels(store, files, asked.corrects, asked.stage, annotator=annotator)
    archive.labels_changed()
    return {
        "counts": done.counts,
        "known": done.known,
        "remarks": list(done.remarks),
        "made": done.rows.column("id").to_pylist(),
        "command": _command(archive, asked, annotator),
    }


def _files(asked: FilesRequest) -> tuple[list[LabelFile], str]:
    """Read the files, and return them with a checksum of their content."""
    refuse_addresses(asked.paths)
    paths = [Path(one).expanduser() for one in asked.paths]
    missing = next((path for path in paths if not path.exists()), None)
    if missing is not None:
        raise KinedexError(
            f"{missing}: there is no such file or folder on the machine of the server; give its whole path"
        )
    files = label_files(paths)
    text = repr([(file.path, file.takes, file.segments, file.covered) for file in files])
    return files, hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _command(archive: Archive, asked: FilesRequest, annotator: str | None) -> str:
    more = ["--corrects", asked.corrects] if asked.corrects else []
    more += ["--stage", asked.stage] if asked.stage and asked.corrects == "annotations" else []
    more += ["--annotator", annotator] if annotator else []
    return command_line("kinedex", "labels", "import", archive.path, *asked.paths, *more)


class LabelExportRequest(RequestBody):
    """A request to export label files."""

    what: Literal["annotations", "labels"]
    folder: Place
    format: str = "eaf"
    takes: tuple[str, ...] = ()
    where: str | None = None
    stage: str | None = None
    force: bool = False


def export_files(archive: Archive, asked: LabelExportRequest, _request: Request) -> Row:
    """Write labels or annotations into the folder, or the one file, that the person names."""
    store = archive.store()
    where = (asked.where or "").strip() or None
    rejected = 0
    if asked.what == "labels":
        takes = stored_labels(store, asked.takes, where)
        if not takes:
            raise KinedexError("no take has a label that could be written")
    else:
        annotations = annotation_labels(store, annotation_stage(store, asked.stage), asked.takes, where)
        takes, rejected = annotations.takes, annotations.rejected
    refuse_addresses(asked.folder)
    folder = Path(asked.folder).expanduser()
    single = folder.suffix.lower().removeprefix(".") in FORMATS and not folder.is_dir()
    place = str(folder) if single else f"{folder}/"
    written = write_labels(takes, None if single else asked.format, place, force=asked.force)
    inside = [one for one in takes if one.take not in written.excluded]
    more = ["--format", asked.format] if not single else []
    more += ["--labels"] if asked.what == "labels" else ["--stage", asked.stage] if asked.stage else []
    more += [word for take in asked.takes for word in ("--take", take)] + (["--where", where] if where else [])
    return {
        "files": [str(path) for path in written.paths[:100]],
        "written": len(written.paths),
        "segments": sum(len(one.labels) for one in inside),
        "takes": len(inside),
        "rejected": rejected,
        "renamed": written.renamed,
        "excluded": list(written.excluded),
        "command": command_line("kinedex", "labels", "export", archive.path, "-o", place, *more),
    }


routes = [
    post("/api/labels/read", read_files, FilesRequest),
    post("/api/labels/import", import_files, ImportRequest, writes=True),
    post("/api/labels/export", export_files, LabelExportRequest, writes=True),
]
