"""Kernels that are compiled before they are needed: the list is whole, and names no kernel twice without a reason."""

from __future__ import annotations

import collections
import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kinedex.ops.kernel_list import call_text, listed_calls, parse_call
from tests.plain_python import PLAIN

SEVERAL: dict[str, tuple[int, str]] = {
    "kinedex.ops.distances.costs.fill_bounds": (2, "bounds of long templates need more than a byte"),
    "kinedex.ops.numeric.span_descriptors._sum_up": (2, "speeds are an array of their own, others are columns of one"),
    "kinedex.ops.templates.averaging.add_others": (2, "clips are numbers or words"),
    "kinedex.ops.templates.warping.align_pairs": (2, "clips are numbers or words"),
}
"""Listed kernels with more signatures than one: how many, and why."""


@pytest.mark.parametrize("call", listed_calls())
def test_a_listed_call_names_a_kernel_and_types_for_its_arguments(call: str) -> None:
    kernel, kinds = parse_call(call)

    assert len(inspect.signature(getattr(kernel, "py_func", kernel)).parameters) == len(kinds)
    assert call_text(getattr(kernel, "py_func", kernel), kinds) == call


def test_a_listed_kernel_has_one_signature_or_a_reason() -> None:
    counts = collections.Counter(call.partition("(")[0] for call in listed_calls())

    assert {kernel: count for kernel, count in counts.items() if count > 1} == {
        kernel: count for kernel, (count, _) in SEVERAL.items()
    }


def test_a_call_that_has_gone_stale_says_how_the_list_is_made_anew() -> None:
    for call in ("kinedex.ops.bits.gone(int64)", "kinedex.ops.bits.popcount(length)", "os.getcwd()", "nothing", "a b"):
        with pytest.raises(ValueError, match=r"kernels\.txt: .*python -m benchmarks\.compilation --write"):
            parse_call(call)


@pytest.mark.skipif(PLAIN, reason="as plain Python nothing is compiled")
def test_compiling_a_call_leaves_what_the_call_loads(tmp_path: Path) -> None:
    call = min(listed_calls(), key=len)
    program = (
        "import sys; from kinedex.ops.kernel_list import compile_call, parse_call; compile_call(sys.argv[1]); "
        "kernel, _ = parse_call(sys.argv[1]); print(*(sum(n.values()) for n in kernel.stats[1:]))"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for expected in ("0 1", "1 0"):  # loaded, compiled
        done = subprocess.run(
            [sys.executable, "-c", program, call],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=200,
        )
        assert done.stdout.split() == expected.split()
