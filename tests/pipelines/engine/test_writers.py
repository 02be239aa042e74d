"""Drawing by name: every name that a stage or a form of export declares is a function, and counts for digests."""

from __future__ import annotations

import ast

import pytest

from kinedex.pipelines.engine.code_digest import ROOT, Sources
from kinedex.pipelines.engine.page_files import drawn_by
from kinedex.pipelines.engine.stage import BUILT_IN

DECLARED = sorted(
    {
        node.value
        for path in (ROOT / "pipelines").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and str(node.value).startswith("kinedex.reports.")
    }
)


@pytest.mark.parametrize("place", DECLARED)
def test_what_is_declared_can_be_called(place: str) -> None:
    assert callable(drawn_by(place))


@pytest.mark.parametrize(
    ("stage", "module_of_page", "page"),
    [("learn_keyframes", "keyframes_page", "keyframes_page"), ("compare_methods", "methods_page", "study_page")],
)
def test_a_stage_that_draws_depends_on_what_draws(stage: str, module_of_page: str, page: str) -> None:
    module, _, name = BUILT_IN[stage].partition(":")
    assert (f"kinedex.reports.{module_of_page}", page) in Sources().reached([(module, name)])
