"""Figures of parts that are finished, kept for each state of the checkout, so that a run can be resumed."""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.harness import ROOT, Figure


def state_of_checkout(root: Path = ROOT) -> str | None:
    """Return a name for the commit and all that was changed since; None without git, as nothing can be kept then."""
    found = []
    for words in (["rev-parse", "HEAD"], ["diff", "HEAD"], ["ls-files", "--others", "--exclude-standard"]):
        try:
            done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, timeout=300)
        except FileNotFoundError:
            return None
        if done.returncode:
            return None
        found.append(done.stdout)
    commit, changes = found[0].decode().strip()[:12], found[1] + found[2]
    return f"{commit}-{hashlib.sha256(changes).hexdigest()[:8]}" if changes else commit


class KeptParts:
    """Figures of parts in files, one a part and state of the checkout, with the seconds that each took.

    Parameters
    ----------
    folder : Path
        Folder of the files, for one size.
    state : str or None
        The name of the state of the checkout; None keeps nothing.
    """

    def __init__(self, folder: Path, state: str | None) -> None:
        self._folder = folder
        self._state = state

    def read(self, part: str) -> list[Figure] | None:
        """Return the figures that are kept of a part; None where there are none."""
        if self._state is None or not (path := self._folder / self._state / f"{part}.json").is_file():
            return None
        return [Figure(**one) for one in json.loads(path.read_text(encoding="utf-8"))["figures"]]

    def write(self, part: str, figures: Sequence[Figure], seconds: float) -> None:
        """Keep the figures of a part, and the seconds that it took."""
        for state in {self._state or "", ""}:
            path = self._folder / state / f"{part}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            content = {"seconds": seconds, "figures": [asdict(one) for one in figures]}
            path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def left(self, parts: Sequence[str]) -> str:
        """Return how long some parts took when they ran last, for a line of progress; "" if one never ran."""
        paths = [self._folder / f"{part}.json" for part in parts if self.read(part) is None]
        if not all(path.is_file() for path in paths):
            return ""
        seconds = sum(json.loads(path.read_text(encoding="utf-8"))["seconds"] for path in paths)
        return f", some {seconds / 60:.1f} min left" if seconds >= 6 else ", seconds left"
