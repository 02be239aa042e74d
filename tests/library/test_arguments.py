"""A value of a wrong type is refused by every public function: the error names the argument and what was expected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import kinedex
from kinedex import ParameterError, Store, Template
from kinedex.library.arguments import checked
from tests.storage.made_up import make_store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return kinedex.open_store(make_store(tmp_path_factory.mktemp("arguments") / "store", {"a": 30}))


WRONG: dict[str, tuple[str, Callable[[Store], object]]] = {
    "open_store": ("path must be a text or a path, got 3", lambda _: kinedex.open_store(3)),  # type: ignore[arg-type]
    "open_store at": ("at must be a whole number or 'newest'", lambda s: kinedex.open_store(s, at="x")),  # type: ignore[arg-type]
    "read": ("path must be a text or a path, got 7", lambda _: kinedex.read(7)),  # type: ignore[arg-type]
    "features": ("rate must be a number, got 'y'", lambda _: kinedex.features([], "y")),  # type: ignore[arg-type]
    "search": ("query must be a Query or a sequence of Query or", lambda s: s.search(5)),  # type: ignore[arg-type]
    "search many": ("query must be", lambda s: s.search([5])),  # type: ignore[list-item]
    "rank": ("tau must be a number, got 'x'", lambda s: s.rank("a", tau="x")),  # type: ignore[arg-type]
    "rank top": ("top must be a whole number or None, got 2.5", lambda s: s.rank("a", top=2.5)),  # type: ignore[arg-type]
    "sql": ("query must be a text, got 4", lambda s: s.sql(4)),  # type: ignore[call-overload]
    "takes": ("where must be a text or None, got True", lambda s: s.takes(True)),  # type: ignore[arg-type]
    "words": ("take must be a text or a whole number or a Take", lambda s: s.words(2.5)),  # type: ignore[arg-type]
    "from_clip": ("take must be a Take, got 'a'", lambda _: Template.from_clip("a")),  # type: ignore[arg-type]
    "learn": ("takes must be a sequence of Take, got 3", lambda _: Template.learn(3)),  # type: ignore[arg-type]
    "annotate": ("takes must be a Store or a Take or", lambda _: kinedex.annotate(3, "a")),  # type: ignore[arg-type]
    "evaluate": ("annotations must be a DataFrame", lambda _: kinedex.evaluate(1, "a")),  # type: ignore[arg-type]
    "run_pipeline": ("pipeline must be a text or a path", lambda s: kinedex.run_pipeline(3, s)),  # type: ignore[arg-type]
    "track": ("recordings must be a text or a path", lambda s: kinedex.track(s, 3)),  # type: ignore[arg-type]
    "stabilise": ("takes must be a text or a sequence", lambda s: kinedex.stabilise(s, 3)),  # type: ignore[arg-type]
    "ingest": ("folder must be a text or a path", lambda s: kinedex.ingest(s, 3)),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_type_is_an_error_that_names_the_argument(store: Store, name: str) -> None:
    expected, call = WRONG[name]
    with pytest.raises(ParameterError) as refused:
        call(store)
    assert str(refused.value).startswith(expected)


def test_what_is_like_a_type_passes(store: Store, tmp_path: Path) -> None:
    assert store.words(np.int64(store["a"].take_id or 0)).shape == (30,)
    assert len(kinedex.open_store(store)) == 1

    @checked
    def measure(tau: float, names: list[str] | None = None, of: str | None = None) -> float:
        return tau

    assert measure(np.float32(0.5)) == 0.5
    assert measure(1, names=["a"]) == 1
    with pytest.raises(TypeError, match="missing a required argument"):
        measure()  # type: ignore[call-arg]
