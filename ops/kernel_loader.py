"""Compiled kernels are loaded from their files without what numba needs only to compile.

Before numba loads a kernel it imports and registers all that it can compile: numpy's functions, BLAS of SciPy, strings,
lists, random numbers. That takes longer than to import numba, and a kernel that has been compiled needs none of it. A
kernel that has not makes numba load everything then, as always.
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
    """Make numba load the kernels of a package alone, from when numba is imported; others are loaded as always.

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
    """Replace how kernels are read from files, where numba has the parts that it is made of."""
    cache = caching.FunctionCache
    if not (hasattr(cache, "_load_overload") and hasattr(cache, "_guard_against_spurious_io_errors")):
        return
    load_as_always: Callable[[Any, Any, Any], Any] = cache.load_overload

    def load_overload(self: Any, signature: Any, context: Any) -> Any:
        if not self._py_func.__module__.startswith(f"{name}."):
            return load_as_always(self, signature, context)
        from numba.core.runtime import rtsys

        rtsys.initialize(context)  # kernels allocate arrays by it
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)

    cache.load_overload = load_overload


class _Finder:
    """Finds numba's module of caches once, as others do, and changes it after it is loaded."""

    def __init__(self, name: str) -> None:
        self._name = name

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of the module of caches; None for any other."""
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
