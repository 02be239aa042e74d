"""Template files: their syntax, reading back what was written, and the errors of invalid files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.template_files import (
    NamedTemplate,
    read_templates,
    write_csv,
    write_yaml,
)
from kinedex.ops.errors import ConfigError
from kinedex.ops.templates.templates import Template

BODY = load_feature_set()
SQUAT = """
squat:
  description: knees bend and stretch
  weights: {rhand_fast: 0, F14: 2.5}
  rows:
    rknee_bent: "00111*00"
    21:         [0, 0, 1, 1, 0.9, "*", 0, 0]
"""


def read(text: str, name: str = "mine.yaml") -> tuple[NamedTemplate, ...]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        return read_templates(path, BODY)


def test_rows_are_named_and_what_has_no_row_is_a_wildcard():
    (squat,) = read(SQUAT)
    assert (squat.name, squat.description) == ("squat", "knees bend and stretch")
    assert squat.template.values[:, 19].tolist() == [0, 0, 1, 1, 1, 0.5, 0, 0]
    assert squat.template.values[:, 20].tolist() == [0, 0, 1, 1, 0.9, 0.5, 0, 0]
    assert np.all(np.delete(squat.template.values, [19, 20], axis=1) == 0.5)
    assert squat.template.weights.tolist() == [1] * 8
    weights = squat.template.feature_weights
    assert weights is not None
    assert (weights[12], weights[13], weights[0]) == (0, 2.5, 1)


values = st.sampled_from([0.0, 0.5, 1.0]) | st.floats(0, 1)


@st.composite
def templates(draw: st.DrawFn) -> Template:
    columns = draw(st.integers(1, 4))
    matrix = draw(arrays.arrays(np.float64, (columns, 40), elements=values, fill=st.just(0.5)))
    weights = draw(arrays.arrays(np.float64, columns, elements=st.floats(0.75, 1.5), fill=st.just(1.0)))
    counts = draw(st.none() | arrays.arrays(np.float64, 40, elements=st.floats(0, 9), fill=st.just(1.0)))
    return Template(matrix, weights, None if counts is None or not counts.any() else counts)


@settings(max_examples=40)
@given(st.dictionaries(st.text(min_size=1), st.tuples(templates(), st.text()), min_size=1, max_size=3))
def test_what_is_written_as_yaml_is_read_as_the_same(found: dict[str, tuple[Template, str]]):
    written = [NamedTemplate(name, template, text) for name, (template, text) in found.items()]
    found_again = read(write_yaml(written, BODY))
    assert [(one.name, one.description) for one in found_again] == [(one.name, one.description) for one in written]
    for there, back in zip(written, found_again, strict=True):
        same(there.template, back.template)
        assert np.array_equal(there.template.weights, back.template.weights)


@settings(max_examples=40)
@given(templates())
def test_what_is_written_as_csv_is_read_as_the_same(template: Template):
    (again,) = read(write_csv(template, BODY), "kick.csv")
    assert again.name == "kick"
    same(template, again.template)


def same(one: Template, other: Template) -> None:
    assert np.array_equal(one.values, other.values)
    assert (one.feature_weights is None) == (other.feature_weights is None)
    if one.feature_weights is not None:
        assert np.array_equal(one.feature_weights, other.feature_weights)


def test_the_ending_decides_the_format(tmp_path: Path):
    (tmp_path / "mine.yaml").write_text(SQUAT)
    (squat,) = read_templates(tmp_path / "mine.yaml", BODY)
    (tmp_path / "squat.csv").write_text("\ufeff" + write_csv(squat.template, BODY), encoding="utf-8")
    (again,) = read_templates(tmp_path / "squat.csv", BODY)
    assert again.name == "squat"
    same(squat.template, again.template)
    for name, message in [
        ("mine.txt", "ends in .yaml or .csv"),
        ("no.csv", "cannot be read"),
        ("no.yaml", "cannot be"),
    ]:
        with pytest.raises(ConfigError, match=message):
            read_templates(tmp_path / name, BODY)


WRONG = [
    ('a:\n  rows:\n    rkne_bent: "01"', 3, "did you mean 'rknee_bent'"),
    ('a:\n  rows:\n    rknee_bent: "01"\n    F20: "01"', 4, "feature 20 has a row already"),
    ('a:\n  rows:\n    rknee_bent: "01"\n    21: "011"', 4, "has 3 columns, but rknee_bent has 2"),
    ('a:\n  rows:\n    rknee_bent: "01x"', 3, r"column 3 must be 0, 1 or \*, got 'x'"),
    ("a:\n  rows:\n    rknee_bent: 011", 3, "put the row in quotes"),
    ("a:\n  rows:\n    rknee_bent: [0, 2]", 3, "column 2 must be a number from 0 to 1"),
    ("a:\n  rows:\n    rknee_bent: []", 3, "a row is a text"),
    ('a:\n  rows:\n    rknee_bent: "01"\n  weights: {rknee: 1}', 4, "no feature 'rknee'"),
    ('a:\n  rows:\n    rknee_bent: "01"\n  weights: {F20: -1}', 4, "greater than or equal to 0"),
    ('a:\n  rows:\n    rknee_bent: "01"\n  column_weights: [1]', 4, "one for each of the 2 columns, got 1"),
    ('a:\n  row:\n    rknee_bent: "01"', 2, "did you mean 'rows'"),
    ("a: 3", 1, "a template is a mapping"),
    ('3:\n  rows: {F20: "1"}', 1, "put it in quotes"),
    ("a:\n  rows: {}", 2, "must have at least 1 entry, got {}"),
    ("{}", 1, "holds no template"),
]


@pytest.mark.parametrize(("text", "line", "message"), WRONG)
def test_an_error_names_the_line_of_an_invalid_file(text: str, line: int, message: str):
    with pytest.raises(ConfigError, match=rf"mine.yaml:{line}: .*{message}"):
        read(text)


WRONG_CSV = [
    ("", 1, "must begin with a line"),
    ("a,b\n", 1, "must begin with a line"),
    ("feature\nF20", 1, "has no columns"),
    ("feature,1,2\nF20,1", 2, "has 2 cells, but the first line has 3"),
    ("feature,1,2\nF20,1,7", 2, "column 2 must be a number from 0 to 1"),
    ("feature,1\nF20,1\nrknee_bent,0", 3, "has a row already"),
    ("feature,1\nF20,1\nF20,0", 3, "has a row already"),
    ("feature,1\nF41,1", 2, "no feature F41"),
    ("feature,weight,1\nF20,x,1", 2, "must be a valid number"),
    ("feature,1\n", 1, "has no feature in it"),
    ('feature,1\n"F20,1', 2, ""),
]


@pytest.mark.parametrize(("text", "line", "message"), WRONG_CSV)
def test_an_error_names_the_line_of_an_invalid_table(text: str, line: int, message: str):
    with pytest.raises(ConfigError, match=rf"kick.csv:{line}: .*{message}"):
        read(text, "kick.csv")
