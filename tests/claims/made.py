"""`python -m tests.claims.made WHAT PATH`: files that a page takes for granted."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from kinedex.catalog.configs import config_path
from tests.bvh_files import write_duet
from tests.claims.printed import ROOT


def features(path: Path) -> None:
    """Write the copy of body40.yaml that docs/howto/own-features.md has its reader make."""
    page = (ROOT / "docs" / "howto" / "own-features.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ {3}(4\d: \{name.*)$", page, re.MULTILINE)
    text = config_path("features", "body40").read_text(encoding="utf-8")
    text = text.replace("mix: [27, 40]", "mix: [27, 42]").replace("[35, 36]]", "[35, 36], [41, 42]]")
    path.write_text(text.replace("name: body40", "name: my-features") + "".join(f"  {line}\n" for line in lines))


def keyframes(path: Path) -> None:
    """Write the copy of keyframes.yaml that docs/keyframe-learning.md has its reader make."""
    text = config_path("pipelines", "keyframes").read_text(encoding="utf-8")
    path.write_text(re.sub(r"^name: .*$", f"name: {path.stem}", text, count=1, flags=re.MULTILINE), encoding="utf-8")


def duets(path: Path) -> None:
    """Write a folder with a BVH file of two persons."""
    path.mkdir()
    write_duet(path / "duet.bvh", 60)


if __name__ == "__main__":
    {"features": features, "keyframes": keyframes, "duets": duets}[sys.argv[1]](Path(sys.argv[2]))
