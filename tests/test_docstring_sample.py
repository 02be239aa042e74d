"""The sample of docstrings by which the language is judged: every docstring has its chance, and a seed repeats it."""

from __future__ import annotations

import pytest

from tests.docstring_sample import Docstring, docstrings, main, product_docstrings, sample

SOURCE = '''"""Measure steps."""

class Step:
    """A step of a foot."""

    length_m: float

    @property
    def long(self) -> bool:
        """True for a step of more than a metre."""
        return self.length_m > 1

def _outer(count: int = 1) -> int:
    """Return the number of steps."""
    if count:
        def inner():
            """Do nothing."""
    return count

def without():
    return 0
'''


def test_docstrings_of_modules_classes_and_functions_are_drawn_with_their_signatures() -> None:
    assert list(docstrings(SOURCE, "ops/steps.py")) == [
        Docstring("ops/steps.py", 1, "steps.py", "", "Measure steps."),
        Docstring("ops/steps.py", 3, "Step", "class Step(): length_m", "A step of a foot."),
        Docstring(
            "ops/steps.py", 9, "Step.long", "@property def long(self) -> bool", "True for a step of more than a metre."
        ),
        Docstring("ops/steps.py", 13, "_outer", "def _outer(count: int=1) -> int", "Return the number of steps."),
        Docstring("ops/steps.py", 16, "_outer.inner", "def inner()", "Do nothing."),
    ]


def test_a_seed_draws_the_same_docstrings_again_and_another_seed_draws_others() -> None:
    found = product_docstrings()
    first = sample(found, 1, 50)
    assert first == sample(found, 1, 50)
    assert len(set(first)) == 50
    assert first != sample(found, 2, 50)
    assert sample(found[:3], 1, 50) == found[:3]


def test_the_command_prints_place_name_signature_and_text(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--seed", "1", "--count", "2"])
    printed = capsys.readouterr().out
    assert printed.startswith("[1] ")
    assert "[2] " in printed
    assert printed.rstrip().endswith("docstrings, seed 1")
    for one in sample(product_docstrings(), 1, 2):
        assert f"{one.path}:{one.line} {one.name}" in printed
        assert one.signature in printed
