"""Tests of kernels that are too long where kernels run as plain Python."""

from __future__ import annotations

import numba
import pytest

PLAIN = bool(numba.config.DISABLE_JIT)
"""True where kernels run as plain Python, a hundred times as slow."""

slow_as_python = pytest.mark.slow_as_python
