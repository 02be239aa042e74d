"""Stores of older formats, made of stores of the present one."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from kinedex.storage.snapshot.manifest_files import manifest_path, versions

FORMAT_3_FIELDS = (
    "format_version",
    "version",
    "created",
    "feature_set",
    "rate_hz",
    "next_take_id",
    "content",
    "frames",
    "takes",
    "results",
    "stages",
)


def as_format_3(store: Path) -> None:
    """Rewrite every manifest of a store as format 3 has it; the parts stay."""
    for version in versions(store):
        path = manifest_path(store, version)
        content = {name: value for name, value in json.loads(path.read_text()).items() if name in FORMAT_3_FIELDS}
        content["format_version"] = 3
        for part in [
            *content["frames"],
            *content["takes"],
            *(part for kind in content["results"].values() for part in kind),
        ]:
            part.pop("xxh3", None)
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        content["checksum"] = hashlib.sha256(text.encode()).hexdigest()
        path.write_text(json.dumps(content))
    (store / "labels").rmdir()
