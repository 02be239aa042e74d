"""The examples in the docstrings of the public API run.

They may use these names: kinedex, np, pl, Take, Template; store and store_path, archive (its source folder), take (a
squat of the store), motion_file (the file of that take), clips (all squats), template (learned from them, named
"squat"), annotations (of the long takes), and folder (an empty one).
"""

from __future__ import annotations

import doctest
import inspect

import pytest

import kinedex
from tests.library.conftest import public_members

PUBLIC = {name: getattr(kinedex, name) for name in kinedex.__all__ if name != "__version__"}
FINDER = doctest.DocTestFinder(recurse=False)


def members(one: type) -> dict[str, object]:
    """The members of a class, those included that it inherits from classes of kinedex."""
    inherited = [vars(base) for base in reversed(one.__mro__) if base.__module__.startswith("kinedex.")]
    return {name: value for names in inherited for name, value in names.items()}


def examples() -> list[doctest.DocTest]:
    """The docstrings with examples: of the package, of functions and classes, and of the methods of classes."""
    found = FINDER.find(kinedex, "kinedex", globs={})
    for name, one in PUBLIC.items():
        found += FINDER.find(one, f"kinedex.{name}", globs={})
        for member, function in public_members(one).items() if inspect.isclass(one) else ():
            called = function.__func__ if isinstance(function, classmethod) else function
            found += FINDER.find(called, f"kinedex.{name}.{member}", globs={})
    return [test for test in found if test.examples]


@pytest.mark.parametrize("example", examples(), ids=lambda test: test.name)
def test_the_example_runs(example: doctest.DocTest, names: dict[str, object]) -> None:
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    example.globs = dict(names)
    runner.run(example, out=report.append)
    assert not runner.failures, "\n".join(report)


def test_every_public_function_and_method_has_an_example() -> None:
    with_example = {test.name for test in examples()}
    wanted = {f"kinedex.{name}" for name, one in PUBLIC.items() if inspect.isfunction(one)}
    for name, one in PUBLIC.items():
        if inspect.isclass(one) and one.__module__.startswith("kinedex.library"):
            methods = [
                key for key, value in members(one).items() if inspect.isroutine(value) and not key.startswith("_")
            ]
            wanted |= {f"kinedex.{name}", *(f"kinedex.{name}.{key}" for key in methods)}
    assert wanted - with_example == set()
