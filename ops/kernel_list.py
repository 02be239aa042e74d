"""This module reads the list of kernels to compile before their first use, with the types of their arguments.

A line of the list has the form of a call: `kinedex.ops.bits.unpack(array(uint64, 2, C), int64)`. Kernels that are
called only by other kernels are not listed, because they are compiled with their callers.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

LIST = Path(__file__).parent / "kernels.txt"


def listed_calls() -> list[str]:
    """Return the lines of the list, in the order in which a first search and the demo use the kernels."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def compile_call(text: str) -> None:
    """Compile the kernel of a line of the list, or load it from the cache; raise the errors of `parse_call`."""
    kernel, kinds = parse_call(text)
    if hasattr(kernel, "compile"):  # without numba's JIT, kernels run as plain Python
        kernel.compile(kinds)


def parse_call(text: str) -> tuple[Any, tuple[Any, ...]]:
    """Parse a line of the list; return the kernel and the types of its arguments.

    Parameters
    ----------
    text : str
        A line of the list.

    Raises
    ------
    ValueError
        There is no such kernel, or no such type.
    """
    try:
        call = ast.parse(text, mode="eval").body
        if not isinstance(call, ast.Call):
            raise ValueError("not a call")
        return _object(ast.unparse(call.func)), tuple(map(_type, call.args))
    except (SyntaxError, AttributeError, ImportError, ValueError, TypeError) as fault:
        raise ValueError(
            f"{LIST.name}: {text}: {fault}; `python -m benchmarks.compilation --write` makes it anew"
        ) from fault


def call_text(function: Any, kinds: Sequence[Any]) -> str:
    """Return the line of the list for a kernel and the types of its arguments.

    Raises
    ------
    ValueError
        A type has no notation in the list.
    """
    return f"{function.__module__}.{function.__qualname__}({', '.join(map(_text, kinds))})"


@functools.cache
def _object(path: str) -> Any:
    module, _, name = path.rpartition(".")
    if not module.startswith("kinedex."):
        raise ValueError(f"{path} is not of kinedex")
    return getattr(import_module(module), name)


def _text(kind: Any) -> str:
    """Convert a numba type to the notation of the list."""
    from numba import types

    if isinstance(kind, types.Array) and kind.aligned:
        return f"{'array' if kind.mutable else 'readonly'}({_text(kind.dtype)}, {kind.ndim}, {kind.layout})"
    if isinstance(kind, types.BaseNamedTuple):
        made = kind.instance_class
        return f"{made.__module__}.{made.__qualname__}({', '.join(map(_text, kind))})"
    if isinstance(kind, types.BaseTuple):
        return f"tuple({', '.join(map(_text, kind))})"
    if isinstance(kind, types.Omitted):
        return f"omitted({kind.value!r})"
    if kind == types.Bytes(types.uint8, 1, "C", readonly=True):
        return "bytes"
    name = str(kind)
    if getattr(types, name, None) != kind:
        raise ValueError(f"a type without words: {kind!r}")
    return name


def _type(node: ast.expr) -> Any:
    """Convert the notation of a type in the list to the numba type."""
    from numba import types

    if isinstance(node, ast.Name):
        return types.Bytes(types.uint8, 1, "C", readonly=True) if node.id == "bytes" else getattr(types, node.id)
    if not isinstance(node, ast.Call):
        raise ValueError(f"{ast.unparse(node)} is no type")
    name = ast.unparse(node.func)
    if name in ("array", "readonly"):
        dtype, dimensions, layout = node.args
        return types.Array(_type(dtype), ast.literal_eval(dimensions), ast.unparse(layout), readonly=name == "readonly")
    if name == "omitted":
        return types.Omitted(ast.literal_eval(node.args[0]))
    members = tuple(map(_type, node.args))
    if name == "tuple":
        return types.Tuple(members)
    return types.BaseTuple.from_types(members, _object(name))
