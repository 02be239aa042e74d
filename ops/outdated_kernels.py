"""This module removes compiled kernels from numba's cache on disk when their source has changed.

numba caches compiled kernels beside their source files, and compiles a kernel again if its own source file has changed.
It does not notice a change in an imported file whose kernels are called, and would use outdated code after an update.
Therefore this module removes the compiled kernels of a file if the file, or one that it imports, has changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path

STAMP = "kernels.json"
"""The file that records the state of the sources at the last compilation: size, modification time and sha256."""

_IMPORT = re.compile(r"^\s*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n]*)|import\s+([\w.]+))", re.MULTILINE)

State = dict[str, tuple[int, int, str]]
"""A dict from source file to its size, modification time in ns and sha256."""


def forget_outdated(package: Path, name: str, environment: Mapping[str, str] = os.environ) -> list[str]:
    """Remove the compiled kernels of files that have changed, or that import a changed file.

    Parameters
    ----------
    package : Path
        The folder of a package whose modules hold the kernels.
    name : str
        The name under which the package is imported, as in `import name.module`.
    environment : mapping of str to str
        Environment variables, which may set the folder of numba's cache.

    Returns
    -------
    list of str
        The files whose kernels were outdated, relative to the folder; empty if numba does not compile, or if its cache
        is not writable, as it then holds no kernels.
    """
    place = _place(package, environment)
    if place is None:
        return []
    stamp = place(package) / STAMP
    try:
        former: State = {
            name: (size, time, text)
            for name, (size, time, text) in json.loads(stamp.read_text(encoding="utf-8")).items()
        }
    except (OSError, ValueError, TypeError, AttributeError):
        former = {}
    now = _state(package, former)
    if now == former:
        return []
    changed = {name for name in {*now, *former} if now.get(name, ("",))[-1] != former.get(name, ("",))[-1]}
    outdated = sorted(_importing(package, name, now, changed))
    try:
        for file in outdated:
            for kernel in place((package / file).parent).glob(f"{Path(file).stem}.*.nb[ic]"):
                kernel.unlink(missing_ok=True)
        _write(stamp, json.dumps(now))
    except OSError:
        return []
    return outdated


def _place(package: Path, environment: Mapping[str, str]) -> Callable[[Path], Path] | None:
    """Return a function from a folder of code to numba's cache folder for it; None if numba does not compile.

    The cache is in `NUMBA_CACHE_DIR` if this is set, otherwise beside the code if that folder is writable, otherwise in
    the user's cache folder.
    """
    if environment.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return None
    if given := environment.get("NUMBA_CACHE_DIR"):
        return partial(_below, Path(given))
    beside = package / "__pycache__"
    if os.access(beside if beside.is_dir() else package, os.W_OK):
        return lambda folder: folder / "__pycache__"
    from numba.misc.appdirs import AppDirs  # imported late: rarely needed, and importing numba takes long

    return partial(_below, Path(AppDirs(appname="numba", appauthor=False).user_cache_dir))


def _below(root: Path, folder: Path) -> Path:
    path = os.path.abspath(folder)
    return root / f"{os.path.basename(path)}_{hashlib.sha1(path.encode()).hexdigest()}"


def _state(package: Path, former: State) -> State:
    """Return the state of the source files; a file is only hashed if its size or time has changed."""
    found: State = {}
    folders = [""]
    for below in folders:
        with os.scandir(package / below) as entries:
            for entry in entries:
                name = f"{below}{entry.name}"
                if entry.name.endswith(".py"):
                    about = entry.stat()
                    size, time, text = former.get(name, (-1, -1, ""))
                    if (size, time) != (about.st_size, about.st_mtime_ns):
                        text = hashlib.sha256((package / name).read_bytes()).hexdigest()
                    found[name] = (about.st_size, about.st_mtime_ns, text)
                elif entry.name != "__pycache__" and entry.is_dir(follow_symlinks=False):
                    folders.append(f"{name}/")
    return found


def _importing(package: Path, name: str, files: Iterable[str], changed: set[str]) -> set[str]:
    """Return the changed files and those that import one of them, directly or not."""
    imports = {file: _imports(package, name, file) for file in files}
    found, fresh = set(changed), set(changed)
    while fresh:
        fresh = {file for file, those in imports.items() if file not in found and those & fresh}
        found |= fresh
    return found


def _imports(package: Path, name: str, file: str) -> set[str]:
    text = (package / file).read_text(encoding="utf-8")
    found = set()
    for source, what, whole in _IMPORT.findall(text):
        module = source or whole
        if module == name or module.startswith(f"{name}."):
            path = module.removeprefix(name).strip(".").replace(".", "/")
            found.add(f"{path}.py")
            found.update(f"{path}/{part}.py".lstrip("/") for part in re.findall(r"\w+", what))
    return found


def _write(path: Path, text: str) -> None:
    import tempfile  # imported late: only needed after an update

    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=".tmp-", dir=path.parent)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(temporary, path)
