"""Kernels that are compiled already are loaded without numba's compiler, and compute what they did."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import kinedex

KERNELS = """\
import numpy as np
from numba import njit


@njit(cache=True)
def mean(x):
    total = np.zeros(len(x))
    for i in range(len(x)):
        if x[i] < 0:
            raise ValueError("less than 0")
        total[i] = x[i] + (total[i - 1] if i else 0)
    return total, np.sqrt(total)


@njit(cache=True)
def counted(x):
    return {int(one): 2 * one for one in x}
"""
CALLS = """\
import sys
import numpy as np
{first}
from kernels.some import counted, mean
total, root = mean(np.array([1.0, 2.0, 6.0]))
try:
    mean(np.array([-1.0]))
except ValueError as fault:
    print(fault)
print(total.tolist(), root.tolist(), "numba.typed.typeddict" in sys.modules, dict(counted(np.array([3, 4]))))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "some.py").write_text(KERNELS)
    return folder


def output(package: Path, first: str) -> list[str]:
    kept = {name: text for name, text in os.environ.items() if not name.startswith("NUMBA")}
    path = f"{package.parent}{os.pathsep}{Path(str(kinedex.__file__)).parents[1]}"
    done = subprocess.run(
        [sys.executable, "-c", CALLS.format(first=first)],
        env=kept | {"PYTHONPATH": path}, capture_output=True, text=True, check=True, timeout=240,
    )  # fmt: skip
    return done.stdout.splitlines()


ALONE = "from kinedex.ops.kernel_loader import load_kernels_alone\nload_kernels_alone('kernels')"
RESULT = "[1.0, 3.0, 9.0] [1.0, 1.7320508075688772, 3.0] {} {{3: 6, 4: 8}}"


@pytest.mark.slow
@pytest.mark.parametrize("early", [True, False], ids=["before numba", "after numba"])
def test_a_compiled_kernel_is_loaded_without_the_compiler(package: Path, early: bool) -> None:
    first = ALONE if early else f"import numba\n{ALONE}"
    assert output(package, first) == ["less than 0", RESULT.format(True)]  # compiles
    assert output(package, first) == ["less than 0", RESULT.format(False)]
    assert output(package, "") == ["less than 0", RESULT.format(True)]  # of another package: as always


@pytest.mark.slow
def test_a_kernel_that_is_not_compiled_yet_is_compiled_after_one_was_loaded_alone(package: Path) -> None:
    assert output(package, ALONE) == ["less than 0", RESULT.format(True)]
    for file in (package / "__pycache__").glob("some.counted-*"):
        file.unlink()
    assert output(package, ALONE) == ["less than 0", RESULT.format(False)]
