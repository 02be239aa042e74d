"""Digests of code change when what is computed can change, and only then."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kinedex.pipelines.engine.code_digest import ROOMS, ROOT, Place, Sources, _module, code_digest
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.stage import BUILT_IN
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.pipelines.keyframes.query_learning import learn_runs

ANNOTATE = [stage.uses for stage in load_pipeline("annotate", {"source": "/x"}).stages]
STAGES = {name: tuple(place.split(":")) for name, place in BUILT_IN.items()}


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A copy of the rooms; its syntax trees are freed in the end."""
    copy = tmp_path_factory.mktemp("copy")
    for room in ROOMS:
        own = ROOT / "kinedex" / room
        source = own if own.is_dir() and not own.is_symlink() else ROOT / room
        shutil.copytree(
            source, copy / source.relative_to(ROOT), ignore=shutil.ignore_patterns("__pycache__", "page", "built")
        )
    yield copy
    _module.cache_clear()


def digests(package: Path, roots: dict[str, Place] | None = None) -> dict[str, str]:
    sources = Sources(package)
    return {name: sources.digest([place]) for name, place in (roots or STAGES).items()}


@pytest.fixture(scope="module")
def before(package: Path) -> dict[str, str]:
    return digests(package)


def edited(path: Path, change: Callable[[str], str]) -> Callable[[], None]:
    """Change a file; the result undoes it."""
    text = path.read_text(encoding="utf-8")
    new = change(text)
    assert new != text, path
    path.write_text(new, encoding="utf-8")
    return lambda: path.write_text(text, encoding="utf-8") and None


def changed(package: Path, before: dict[str, str], file: str, old: str, new: str) -> set[str]:
    """The stages whose digest another text in a file changes."""
    assert old in (package / file).read_text(encoding="utf-8"), f"{file} has no {old!r}"
    undo = edited(package / file, lambda text: text.replace(old, new, 1))
    try:
        after = digests(package)
    finally:
        undo()
    return {name for name in before if before[name] != after[name]}


def test_a_constant_of_a_kernel_changes_the_stages_that_use_it(package: Path, before: dict[str, str]) -> None:
    found = {
        name: changed(package, before, file, old, new)
        for name, (file, old, new) in {
            "time warping": ("ops/templates/templates.py", "MAX_ROUNDS = ", "MAX_ROUNDS = 1 + "),
            "decoding": ("ops/annotation/decoding.py", "STANDING_OUT = ", "STANDING_OUT = 1 + "),
        }.items()
    }
    report = {"report"}  # it names the parameters of every stage, so it depends on all of them
    learn = {"learn_templates", "learn_keyframes", "evaluate_ranking", "annotate", "compare_methods"}
    annotate = {"annotate", "compare_methods", "evaluate"}  # evaluate reads the parameters of annotate, a method too
    assert found["time warping"] == learn | annotate | report
    assert found["decoding"] == annotate | report


def test_reports_count_for_the_stages_that_write_them_alone(package: Path, before: dict[str, str]) -> None:
    paths = sorted((package / "reports").glob("*.py"))
    undo = [
        edited(path, lambda text: text.replace("return ", "return None or "))
        for path in paths
        if "return " in path.read_text()
    ]
    learning = {"runs": (learn_runs.__module__, "learn_runs")}
    assert paths
    try:
        after, learned = digests(package), digests(package, learning)
    finally:
        for one in undo:
            one()
    writers = {"report", "compare_methods"}
    assert {name for name in ANNOTATE if before[name] != after[name]} == writers & set(ANNOTATE)
    assert learned == digests(package, learning)


def test_annotations_and_what_runs_a_stage_do_not_count(package: Path, before: dict[str, str]) -> None:
    undo = []
    for file, old, new in (
        ("ops/errors.py", "def did_you_mean(name: str,", "def did_you_mean(name: 'str | None',"),
        ("pipelines/engine/executors.py", "TRIES = 3", "TRIES = 4"),
        ("pipelines/engine/executors.py", "return map(function, items)", "return iter(list(map(function, items)))"),
        ("pipelines/engine/run_id.py", "def new_run_id() -> str:", "def new_run_id() -> str:\n    assert True"),
        ("kinedex/console/terminal.py", "WIDE = ", "WIDE = 1 + "),
    ):
        undo.append(edited(package / file, lambda text, old=old, new=new: text.replace(old, new, 1)))  # type: ignore[misc]
    try:
        after = digests(package)
    finally:
        for one in reversed(undo):
            one()
    assert {name for name in before if before[name] != after[name]} == set()


def write(folder: Path, **modules: str) -> Sources:
    for name, text in modules.items():
        (folder / "rooms").mkdir(exist_ok=True)
        (folder / "rooms" / "__init__.py").touch()
        (folder / "rooms" / f"{name}.py").write_text(text)
    return Sources(folder)


def names(sources: Sources, root: str = "f") -> set[str]:
    found = sources.reached([("kinedex.rooms.a", root)])
    return {f"{module.removeprefix('kinedex.rooms.')}:{name}" for module, name in found}


def test_names_are_followed_through_imports(tmp_path: Path) -> None:
    sources = write(
        tmp_path,
        a="from kinedex.rooms import b\nfrom kinedex.rooms.b import g as other\n"
        "def f():\n    from kinedex.rooms.c import h\n    return b.one() + other() + h()\ndef unused(): pass\n",
        b="from kinedex.rooms.c import LIMIT\ndef one(): return LIMIT\ndef g(): return 1\ndef unused(): pass\n",
        c="LIMIT = 1\nTOTAL = 2\nTOTAL += LIMIT\ndef h(): return TOTAL\ndef unused(): pass\n",
    )
    assert names(sources) == {"a:f", "b:one", "b:g", "c:h", "c:LIMIT", "c:TOTAL"}


def test_a_class_counts_with_its_methods_and_its_bases(tmp_path: Path) -> None:
    sources = write(
        tmp_path,
        a="from kinedex.rooms.b import Thing\ndef f(thing: 'Thing'):\n    return thing.size()\n",
        b="class Base:\n    def start(self): return LIMIT\nclass Thing(Base):\n"
        "    def size(self): return self.start()\nLIMIT = 3\nclass Other: pass\n",
    )
    assert names(sources) == {"a:f", "b:Thing", "b:Base", "b:LIMIT"}


def test_statements_that_run_on_import_count(tmp_path: Path) -> None:
    sources = write(
        tmp_path,
        a="import kinedex.rooms.b\nfrom typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import kinedex.rooms.c\n"
        "def f(): return 1\n",
        b="import numpy\nnumpy.seterr(all='raise')\ndef g(): return 1\nif __name__ == '__main__':\n    g()\n",
        c="print('for type checkers')\n",
    )
    assert names(sources) == {"a:f", "b:*"}


def test_what_cannot_be_followed_counts_as_a_whole(tmp_path: Path) -> None:
    sources = write(
        tmp_path,
        a="from kinedex.rooms import b\nimport importlib\nPARTS = {'x': 'kinedex.rooms.c:g'}\n"
        "def f(): return vars(b), importlib.import_module(PARTS['x'])\n",
        b="def one(): pass\nclass Two:\n    def method(self): pass\n",
        c="def g(): return 1\ndef h(): return 2\n",
    )
    assert names(sources) == {"a:f", "a:PARTS", "b:", "b:one", "b:Two", "c:g"}


def test_functions_of_this_program_have_a_digest() -> None:
    assert code_digest(analyse) == code_digest(f"{analyse.__module__}:analyse")
    assert code_digest(analyse) != code_digest(analyse, learn_runs)
    assert len(code_digest(analyse)) == 16


def test_a_docstring_or_a_comment_changes_nothing(package: Path, before: dict[str, str]) -> None:
    undo = [
        edited(path, lambda text: text.replace('"""', '"""Other words. ', 1) + "\n# a remark\n")
        for path in sorted(package.rglob("*.py"))[::4]
        if path.read_text(encoding="utf-8").startswith('"""')
    ]
    assert len(undo) > 100
    try:
        assert digests(package) == before
    finally:
        for one in undo:
            one()
