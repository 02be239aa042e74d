"""Fixtures for real data; tests that need it are skipped where it is missing."""

from __future__ import annotations

import gc
import os
import sys
from collections import Counter
from functools import lru_cache
from pathlib import Path

import pytest
import typer.testing
from hypothesis import settings

from tests.plain_python import PLAIN
from tests.real_data import SHARED, takes_other_data
from tests.shared_kernels import compile_in_one_worker

# The first call of a kernel compiles it, and tests run beside each other: time proves nothing about correctness.
settings.register_profile("kinedex", deadline=None)
settings.load_profile("kinedex")

# Typer would make all commands of the program anew, from the hints of their functions, for each that a test runs.
typer.testing._get_command = lru_cache(typer.testing._get_command)

# Tests start hundreds of processes, which compile every module anew where the environment forbids files of bytecode.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


SLOW_SECONDS = 900
"""The time-out of a slow test; that of the others stands in pyproject.toml."""


def pytest_configure() -> None:
    """Collect garbage less often, and let workers that need the same kernel wait for the one that compiles it."""
    gc.set_threshold(10_000, 20, 10)
    if "PYTEST_XDIST_WORKER" in os.environ:
        compile_in_one_worker()


def pytest_collection_finish() -> None:
    """Keep the garbage collector away from modules and collected tests, which cost it a quarter of a worker's time."""
    gc.collect()
    gc.freeze()


def pytest_unconfigure() -> None:
    """Let the end of the process free everything, or else libraries print what they miss."""
    gc.unfreeze()


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests with real data, and begin with the slow tests: at the end all other processes would wait."""
    for item in items:
        if "shared" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.shared)
        elif takes_other_data(item.path):
            item.add_marker(pytest.mark.other_data)
        if PLAIN and item.get_closest_marker("slow_as_python") is not None:
            item.add_marker(pytest.mark.skip(reason="as plain Python it takes minutes"))
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
    for item in items:
        if item.get_closest_marker("slow") is not None and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(SLOW_SECONDS))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say why tests were skipped, in one line a reason."""
    reasons: Counter[str] = Counter()
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        reasons[reason.removeprefix("Skipped: ")] += 1
    for reason, count in sorted(reasons.items(), key=lambda one: (-one[1], one[0])):
        terminalreporter.write_line(f"{count} skipped: {reason}")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real data and reference results beside the checkout; skips where it is missing."""
    if not (SHARED / "data").is_dir():
        pytest.skip("no ../shared beside the checkout: comparisons with real data are left out")
    return SHARED
