"""Compiled kernels are those of the source, also where only a kernel that they call has changed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import kinedex
from kinedex.ops.outdated_kernels import STAMP, forget_outdated

CALLED = "from numba import njit\n\n\n@njit(cache=True)\ndef step(x):\n    return x + {number}\n"
CALLING = """\
from numba import njit

from kernels.deep.called import step


@njit(cache=True)
def twice(x):
    return step(step(x))
"""
GUARDED = """\
from pathlib import Path

from kinedex.ops.outdated_kernels import forget_outdated

forget_outdated(Path(__file__).parent, __name__)
"""
OTHER = "from numba import njit\n\n\n@njit(cache=True)\ndef half(x):\n    return x / 2\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "kernels"
    (folder / "deep").mkdir(parents=True)
    (folder / "__init__.py").write_text(GUARDED)
    (folder / "deep" / "__init__.py").write_text("")
    (folder / "deep" / "called.py").write_text(CALLED.format(number=1))
    (folder / "calling.py").write_text(CALLING)
    (folder / "other.py").write_text(OTHER)
    return folder


def environment(package: Path, **more: str) -> dict[str, str]:
    kept = {name: text for name, text in os.environ.items() if not name.startswith("NUMBA")}
    return kept | {"PYTHONPATH": f"{package.parent}{os.pathsep}{Path(str(kinedex.__file__)).parents[1]}"} | more


def twice(package: Path, **more: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", "from kernels.calling import twice; print(twice(0))"],
        env=environment(package, **more), check=True, capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    return int(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("elsewhere", [False, True], ids=["beside the files", "elsewhere"])
def test_a_kernel_is_compiled_again_when_one_that_it_calls_has_changed(
    package: Path, tmp_path: Path, elsewhere: bool
) -> None:
    more = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} if elsewhere else {}
    assert twice(package, **more) == 2
    (package / "deep" / "called.py").write_text(CALLED.format(number=50))
    assert twice(package, **more) == 100


def test_only_what_imports_a_changed_file_is_forgotten(package: Path) -> None:
    kernels = [package / "__pycache__" / f"{name}-1.py311.nbi" for name in ("calling.twice", "other.half")]
    kernels.append(package / "deep" / "__pycache__" / "called.step-5.py311.nbi")
    assert sorted(forget_outdated(package, "kernels", {})) == [
        "__init__.py", "calling.py", "deep/__init__.py", "deep/called.py", "other.py",
    ]  # fmt: skip
    for kernel in kernels:
        kernel.parent.mkdir(exist_ok=True)
        kernel.write_text("compiled")
    assert forget_outdated(package, "kernels", {}) == []
    (package / "deep" / "called.py").write_text(CALLED.format(number=12))
    assert forget_outdated(package, "kernels", {}) == ["calling.py", "deep/called.py"]
    assert [kernel.exists() for kernel in kernels] == [False, True, False]


def test_a_file_of_the_same_content_is_the_same_whenever_it_was_written(package: Path) -> None:
    forget_outdated(package, "kernels", {})
    os.utime(package / "other.py", (1, 1))
    assert forget_outdated(package, "kernels", {}) == []
    assert json.loads((package / "__pycache__" / STAMP).read_text())["other.py"][1] == 1_000_000_000


def test_a_broken_note_of_what_was_compiled_counts_as_none(package: Path) -> None:
    forget_outdated(package, "kernels", {})
    (package / "__pycache__" / STAMP).write_text('{"other.py": 3}')
    assert len(forget_outdated(package, "kernels", {})) == 5


def test_where_nothing_is_compiled_nothing_is_forgotten(package: Path) -> None:
    assert forget_outdated(package, "kernels", {"NUMBA_DISABLE_JIT": "1"}) == []
    assert not (package / "__pycache__").exists()
