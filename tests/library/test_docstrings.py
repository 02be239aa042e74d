"""The docstrings of the public API are numpydoc that numpydoc's own validation accepts."""

from __future__ import annotations

import inspect
from functools import cached_property

import pytest
from numpydoc.validate import validate

import kinedex
from tests.library.conftest import public_members

IGNORED = {
    "GL01": "summaries stand on the first line, behind the quotes, in the whole project",
    "ES01": "a complete summary needs no second paragraph",
    "SA01": "the page docs/python.md connects the functions",
    "EX01": "tests/library/test_doctests.py knows better who needs an example",
}
"""Checks that do not count, and why."""

MADE_BY_KINEDEX = (
    *("Difference", "Evaluation", "FeatureSet", "Labels", "Outcome", "Picture", "Store", "Take", "Template"),
    *("ConfigError", "ParameterError", "SourceError"),
)
"""Classes whose constructor users do not call; its parameters are not documented (PR01)."""

PUBLIC = {name: getattr(kinedex, name) for name in kinedex.__all__ if name != "__version__"}


def documented() -> list[str]:
    """The import path of every public name, and of the public members of classes of the API."""
    found = []
    for name, one in PUBLIC.items():
        found.append(f"kinedex.{name}")
        for member, value in public_members(one).items() if inspect.isclass(one) else ():
            if inspect.isroutine(value) or isinstance(value, property | cached_property):
                found.append(f"kinedex.{name}.{member}")
    return found


@pytest.mark.parametrize("path", documented())
def test_the_docstring_is_valid_numpydoc(path: str) -> None:
    faults = [
        (code, text)
        for code, text in validate(path)["errors"]
        if code not in IGNORED and not (code == "PR01" and path.split(".")[-1] in MADE_BY_KINEDEX)
    ]
    assert faults == []
