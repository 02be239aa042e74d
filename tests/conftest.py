"""Fixtures for real data; tests that need it are skipped where it is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

# The first call of a kernel compiles it, and tests run beside each other: time says nothing about correctness.
settings.register_profile("kinedex", deadline=None)
settings.load_profile("kinedex")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the slow tests: one of them at the end would be waited for by all other processes."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real data and reference results beside the checkout; skips where it is missing."""
    if not (SHARED / "data").is_dir():
        pytest.skip("no ../shared beside the checkout: comparisons with real data are left out")
    return SHARED
