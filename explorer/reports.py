"""Reports of the store: `GET /api/reports/NAME` answers with a file that a stage wrote, in a sandbox of its own.

A report is a page with inline scripts over names that anybody may have chosen. It gets an origin of its own by its
content policy, so that its scripts have neither the cookie of the explorer nor an answer of the server.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

from starlette.responses import FileResponse

from kinedex.explorer.addresses import get
from kinedex.explorer.answers import NotFoundError
from kinedex.storage.store.history import refuse_damaged_report

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.archive import Archive

FOLDER = "results/reports"
"""The folder of the store with the files that stages write beside their results."""

POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The content policy of a report: inline scripts in an origin of its own, and nothing loaded from anywhere."""

TYPES = {
    ".html": "text/html",
    ".json": "application/json",
    ".csv": "text/csv",
    ".md": "text/plain",
    ".txt": "text/plain",
}
"""A dict from file extension to media type; files with other extensions are sent as downloads."""


def report_names(archive: Archive) -> dict[tuple[str, str], list[str]]:
    """Return a dict from (stage, stage run) to the files that it wrote, relative to the folder of reports."""
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    for key, record in archive.store().manifest.stages.items():
        for name in record.summary.get("files", ()):
            if isinstance(name, str) and name.startswith(f"{FOLDER}/"):
                found[key, record.run].append(name.removeprefix(f"{FOLDER}/"))
    return dict(found)


def report_file(archive: Archive, name: str) -> Path:
    """Return the path of a report.

    Raises
    ------
    NotFoundError
        No stage of the store has written a file of this name, or the file is gone or leads out of the folder.
    StoreError
        The file is not as its stage wrote it.
    """
    folder = (archive.path / FOLDER).resolve()
    path = (folder / name).resolve()
    is_known = any(name in names for names in report_names(archive).values())
    if not is_known or not path.is_relative_to(folder) or not path.is_file():
        raise NotFoundError(f"no report of this store has the name {name}; the page Runs lists those that there are")
    refuse_damaged_report(path)
    return path


def send_report(archive: Archive, request: Request) -> FileResponse:
    """Return the response with the file of a report."""
    path = report_file(archive, request.path_params["name"])
    kind = TYPES.get(path.suffix.lower())
    headers = {
        "content-security-policy": POLICY,
        "cross-origin-opener-policy": "unsafe-none",  # browsers block a sandboxed page with any other
        "cache-control": "no-store",
    }
    saved_as = None if kind else path.name
    return FileResponse(path, headers=headers, media_type=kind or "application/octet-stream", filename=saved_as)


routes = [get("/api/reports/{name:path}", send_report)]
