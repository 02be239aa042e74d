"""Find the folders of the running package and of the installed one, which can differ in a checkout."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname


def running_package() -> Path:
    """Return the folder of the `kinedex` package that is running."""
    return Path(__file__).parents[1].resolve()


def installed_package() -> Path | None:
    """Return the folder of the installed package; for an editable install, that of its checkout; None without one."""
    try:
        found = distribution("kinedex")
    except PackageNotFoundError:
        return None
    try:
        source = json.loads(found.read_text("direct_url.json") or "{}")
    except json.JSONDecodeError:
        source = {}
    if source.get("dir_info", {}).get("editable"):
        return Path(url2pathname(urlparse(source["url"]).path)).resolve() / "kinedex"
    return Path(str(found.locate_file("kinedex"))).resolve()
