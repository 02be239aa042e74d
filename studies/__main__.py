"""`python -m studies`: list the studies."""

from __future__ import annotations

import ast
from pathlib import Path


def studies() -> dict[str, str]:
    """Return the first sentence of every module that is a program, by its name."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        line = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]
        if line.startswith("`python -m studies."):
            found[path.stem] = line
    return found


if __name__ == "__main__":
    print("\n".join(studies().values()))
