"""This module lets numba load compiled kernels from its cache without the modules that it needs only to compile.

Before numba loads a kernel, it imports and registers everything that it can compile: numpy's functions, BLAS of SciPy,
strings, lists, random numbers. This takes longer than importing numba, and a compiled kernel needs none of it. If a
kernel is not yet compiled, numba loads everything as usual.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_CACHING = "numba.core.caching"


def load_kernels_alone(name: str) -> None:
    """Make numba load the cached kernels of one package without compiler modules; others are loaded as usual.

    Parameters
    ----------
    name : str
        The name of the package.
    """
    if (caching := sys.modules.get(_CACHING)) is not None:
        _change(caching, name)
    else:
        sys.meta_path.insert(0, _Finder(name))


def _change(caching: ModuleType, name: str) -> None:
    """Replace numba's function that reads cached kernels, if numba has the parts that the replacement needs."""
    cache = caching.FunctionCache
    if not (hasattr(cache, "_load_overload") and hasattr(cache, "_guard_against_spurious_io_errors")):
        return
    load_as_always: Callable[[Any, Any, Any], Any] = cache.load_overload

    def load_overload(self: Any, signature: Any, context: Any) -> Any:
        if not self._py_func.__module__.startswith(f"{name}."):
            return load_as_always(self, signature, context)
        from numba.core.runtime import rtsys

        rtsys.initialize(context)  # kernels need this to allocate arrays
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)

    cache.load_overload = load_overload


class _Finder:
    """An import hook that finds numba's caching module once, as usual, and patches it after it is loaded."""

    def __init__(self, name: str) -> None:
        self._name = name

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the import specification of numba's caching module; None for any other module."""
        if fullname != _CACHING or self not in sys.meta_path:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_change(module: ModuleType) -> None:
                load(module)
                _change(module, self._name)

            spec.loader.exec_module = load_and_change  # type: ignore[method-assign]
        return spec
