"""The folder of real data and reference results, which is no part of the repository: the one place that knows where.

It stands beside the checkout as `../shared`. KINEDEX_SHARED names another folder; `KINEDEX_SHARED=none` hides it, so
that everything runs as where it is missing.
"""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_READERS = r"(?:benchmarks|studies|tests)[\w.]*"
"""The packages whose modules look for the folder."""

_IMPORT = re.compile(rf"^\s*(?:import ({_READERS})|from ({_READERS}) import (\([^)]*\)|.*))", re.MULTILINE)

NONE = "none"
"""The value of KINEDEX_SHARED that hides the folder."""


def shared_folder(given: str | None, checkout: Path) -> Path:
    """Return the folder of real data; it need not be there.

    Parameters
    ----------
    given : str or None
        The value of KINEDEX_SHARED, None where it is not set.
    checkout : Path
        Folder of the checkout.
    """
    if given == NONE:
        return checkout / "build" / "no real data"
    return Path(given).resolve() if given else checkout.parent / "shared"


SHARED = shared_folder(os.environ.get("KINEDEX_SHARED"), ROOT)


@cache
def takes_other_data(module: Path) -> bool:
    """Return whether a module of tests takes other data where the folder is missing.

    Such a module imports this one, or a module that does; those that ask for the fixture `shared` of tests/conftest.py
    are skipped instead.
    """
    return _reaches(module, frozenset())


def _reaches(module: Path, seen: frozenset[Path]) -> bool:
    for name in _imports(module):
        path = ROOT.joinpath(*name.split("."))
        file = path.with_suffix(".py") if path.with_suffix(".py").is_file() else path / "__init__.py"
        if file == Path(__file__).resolve():
            return True
        if not file.is_file() or file in seen or file == ROOT / "tests" / "conftest.py":
            continue
        seen |= {file}
        if _reaches(file, seen):
            return True
    return False


@cache
def _imports(module: Path) -> tuple[str, ...]:
    """Return the modules of the checkout, beside kinedex, that a module imports; names of them may be no modules."""

    found: list[str] = []
    for plain, origin, names in _IMPORT.findall(module.read_text(encoding="utf-8")):
        found += [plain] if plain else [origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", names))]
    return tuple(found)
