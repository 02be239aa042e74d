"""Read arrays of NPY and NPZ files and of pickles safely: no code in them runs, and no stated size is trusted.

A pickle is a program. Here it can make numbers, texts, lists, tuples, dicts and NumPy arrays: functions that it names
are replaced by those of this module, which record the parts of an array; any other name is an error. The arrays are
made from these parts afterwards, if shape, type and bytes agree.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.source_files import file_size, source_errors

MAX_BYTES = 2 << 30
"""The largest memory of an array in bytes; compressed files may claim any size."""


def load_arrays(path: Path, wanted: Iterable[str]) -> tuple[dict[str, npt.NDArray[Any]], list[str]]:
    """Return the wanted arrays of an NPZ file that exist, and the names of all its arrays.

    Parameters
    ----------
    path : Path
        The file.
    wanted : iterable of str
        Names of arrays.

    Raises
    ------
    SourceError
        The file cannot be read, or an array's header does not fit its bytes.
    """
    with _numpy_errors(path), zipfile.ZipFile(path) as packed:
        keys = {entry.filename.removesuffix(".npy"): entry for entry in packed.infolist()}
        arrays = {}
        for key in keys.keys() & set(wanted):
            with packed.open(keys[key]) as entry:
                arrays[key] = _array(path, entry, f"'{key}'", keys[key].file_size)
        return arrays, list(keys)


def array_shapes(path: Path) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Return a dict from array name to shape and type in an NPZ file, by the headers; an NPY file has the name "".

    Raises
    ------
    SourceError
        The file cannot be read.
    """
    headers = {}
    with _numpy_errors(path):
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:
                headers[""] = npy_header(file)
        else:
            with zipfile.ZipFile(path) as packed:
                for entry in packed.infolist():
                    if entry.filename.endswith(".npy"):
                        with packed.open(entry) as part:
                            headers[entry.filename.removesuffix(".npy")] = npy_header(part)
    return {name: (shape, dtype) for name, (shape, _, dtype) in headers.items()}


def load_array(path: Path) -> npt.NDArray[Any]:
    """Return the array of an NPY file; raise SourceError if it cannot be read or is truncated."""
    with _numpy_errors(path), path.open("rb") as file:
        return _array(path, file, "the file", path.stat().st_size)


def array_names(path: Path) -> list[str]:
    """Return the names of an NPZ file's arrays; empty if the file cannot be read."""
    try:
        with zipfile.ZipFile(path) as packed:
            return [name.removesuffix(".npy") for name in packed.namelist()]
    except Exception:  # zipfile raises many classes of errors for damaged data; the file's reader reports the fault
        return []


def npy_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read the header of an NPY file: shape, whether it is stored by columns, and type."""
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return read_header(file)


@contextmanager
def _numpy_errors(path: Path) -> Iterator[None]:
    """Turn the many errors that NumPy, zipfile, zlib and tokenize raise for damaged data into a SourceError."""
    try:
        yield
    except SourceError:
        raise
    except Exception as fault:
        raise SourceError(path, f"cannot be read as NumPy arrays: {fault}") from None


def _array(path: Path, file: IO[bytes], what: str, size: int) -> npt.NDArray[Any]:
    """Return an array in NPY format of `size` bytes in all, after a check of its header against them."""
    shape, _, dtype = npy_header(file)
    numbers = math.prod(shape)
    if dtype.hasobject:
        raise SourceError(
            path, f"{what} holds Python objects ({dtype}), which are pickled and could run any code, so they are not "
            "read; with a program that you trust, save it as an array of numbers or texts",
        )  # fmt: skip
    if numbers * dtype.itemsize != size - file.tell():
        raise SourceError(
            path,
            f"{what} must hold {' × '.join(map(str, shape))} values of {dtype} by its header, and holds "
            f"{size - file.tell()} bytes; is it cut off?",
        )
    if numbers * 8 > MAX_BYTES:
        most = f"{MAX_BYTES / 1e9:.1f} GB"
        raise SourceError(
            path, f"{what} takes {numbers * 8 / 1e9:.1f} GB in memory; write shorter takes, of {most} at most"
        )
    file.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    if dtype.kind == "U" and array.size:
        # invalid code points would make Python fail later
        letters = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("="))).view(np.uint32)
        if letters.max(initial=0) > sys.maxunicode:
            raise SourceError(path, f"{what} has characters that are not valid Unicode: its texts are damaged")
    return array


MAX_PICKLE_BYTES = 512 << 20
"""The largest size of a pickle in bytes."""

MAX_TUPLES = 20_000
"""The largest number of tuples; more could be nested so deeply that Python fails."""

MAX_LISTS = 200_000
"""The largest number of lists and dicts; each takes far more memory than the byte that creates it."""

MAX_LETTERS = 1 << 24
"""The largest number of letters of a list of texts, each as long as the longest."""

_WAY_OUT = (
    "a pickle can run any code, so only numbers, texts, lists, dicts and NumPy arrays are read; with a program that "
    "you trust, save its arrays by `numpy.savez('take.npz', **arrays)`"
)
_OPCODES = frozenset(
    "PROTO FRAME STOP MARK POP POP_MARK DUP NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 "
    "LONG4 FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING UNICODE SHORT_BINUNICODE BINUNICODE "
    "BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 EMPTY_LIST APPEND APPENDS LIST EMPTY_TUPLE "
    "TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_DICT DICT SETITEM SETITEMS GET BINGET LONG_BINGET PUT BINPUT "
    "LONG_BINPUT MEMOIZE GLOBAL STACK_GLOBAL REDUCE BUILD".split()
)
_DTYPE = re.compile(r"[<>=|]?([fiu][1248]|b1|[SU]\d{1,4})")
_PACKED = {b"\x1f\x8b": "gzip", b"\x78\x01": "zlib", b"\x78\x5e": "zlib", b"\x78\x9c": "zlib", b"\x78\xda": "zlib"}


class _Refused(Exception):
    """The file uses a function or an instruction that is not allowed."""


class _Call:
    """A function that a pickle may call; it has no attributes that a pickle could set."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: object) -> NoReturn:
        raise _Refused("changes a function")


class _Type:
    """The parts of a NumPy type: its code, and its byte order."""

    __slots__ = ("code", "order")

    def __init__(self, code: object = "", *_: object) -> None:
        self.code, self.order = code, "="

    def __setstate__(self, state: Any) -> None:
        self.order = (
            state[1] if isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">", "=", "|") else "="
        )

    def dtype(self) -> np.dtype[Any]:
        """Return the type; raise an error unless it is a number, bool or text."""
        if not isinstance(self.code, str) or not _DTYPE.fullmatch(self.code):
            raise _Refused(f"holds an array of type {str(self.code)[:20]!r}")
        return np.dtype(self.code).newbyteorder(self.order)  # type: ignore[arg-type]


class _Array:
    """The parts of an array: shape, type, order and bytes; the array itself is made only on request."""

    __slots__ = ("_parts",)

    def __init__(self, *parts: Any) -> None:
        self._parts: tuple[Any, ...] = parts

    def __setstate__(self, state: Any) -> None:
        self._parts = state[1:] if isinstance(state, tuple) and len(state) == 5 else ()

    def array(self) -> npt.NDArray[Any]:
        """Return the array; raise an error if the parts do not agree."""
        if len(self._parts) != 4:
            raise _Refused("holds an array without its numbers")
        shape, kind, fortran, data = self._parts
        whole = isinstance(shape, tuple) and all(isinstance(n, int) and 0 <= n < 1 << 40 for n in shape)
        if not whole or len(shape) > 8 or not isinstance(kind, _Type):
            raise _Refused("holds an array of a shape that makes no sense")
        data = data.encode("latin-1") if isinstance(data, str) else data
        dtype = kind.dtype()
        if (
            not isinstance(data, (bytes, bytearray))
            or len(data) != math.prod(shape) * dtype.itemsize
            or not dtype.itemsize
        ):
            raise _Refused("holds an array whose shape does not fit its bytes")
        found: npt.NDArray[Any] = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
        return found


def _scalar(kind: object, data: object = b"") -> _Array:
    return _Array((), kind, False, data)


def _frombuffer(data: object, kind: object, shape: object, order: object) -> _Array:
    return _Array(shape, kind, order == "F", data)


def _encoded(text: object, encoding: object = "latin1") -> bytes:
    if isinstance(text, str) and encoding in ("latin1", "latin-1"):
        return text.encode("latin-1")
    raise _Refused("encodes a text")


def _no_bytes(*arguments: object) -> bytes:
    """Stand in for `bytes()`, by which older pickle protocols encode empty bytes; refuse a call with arguments."""
    if arguments:
        raise _Refused("asks for bytes of its choice")
    return b""


_NUMPY = ("numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric", "numpy")
_MADE: dict[str, Callable[..., Any]] = {
    "_reconstruct": lambda *_: _Array(), "scalar": _scalar, "_frombuffer": _frombuffer, "dtype": _Type,
    "ndarray": lambda *_: _Array(),
}  # fmt: skip


class _Unpickler(pickle.Unpickler):
    """An unpickler that substitutes its own functions for those of NumPy, and allows no other name."""

    def find_class(self, module: str, name: str) -> _Call:
        """Return the substitute for a function that the file names."""
        if module in _NUMPY and name in _MADE:
            return _Call(_MADE[name])
        if (module, name) == ("_codecs", "encode"):
            return _Call(_encoded)
        if name == "bytes" and module in ("builtins", "__builtin__"):
            return _Call(_no_bytes)
        if (module, name) == ("collections", "OrderedDict"):
            return _Call(lambda *pairs: dict(*pairs))
        raise _Refused(f"asks for {module[:60]}.{name[:60]}")


def load_pickle(path: Path) -> dict[str, Any]:
    """Return the arrays, numbers, texts and dicts of a pickle that holds a dict.

    Parameters
    ----------
    path : Path
        The file; those of Python 2 are read, too.

    Returns
    -------
    dict of str to array or dict
        Lists of floats and of texts become arrays; values that are neither numbers nor texts are left out.

    Raises
    ------
    SourceError
        The file is compressed, damaged, or holds anything but numbers; the error states the remedy.
    """
    if file_size(path) > MAX_PICKLE_BYTES:
        raise SourceError(path, f"has more than {MAX_PICKLE_BYTES >> 20} MB, which no pickle of a take has")
    with source_errors(path):
        data = path.read_bytes()
    try:
        if data[:2] in _PACKED:
            raise _Refused(f"is packed by {_PACKED[data[:2]]}, as joblib and others write it")
        _check(data)
        found = _Unpickler(io.BytesIO(data), encoding="latin1").load()
        if not isinstance(found, dict):
            raise _Refused("holds no dict of arrays by name")
        return _plain(found, 3)
    except _Refused as fault:
        raise SourceError(path, f"{fault}; {_WAY_OUT}") from None
    except Exception as fault:  # the unpickler raises many classes of errors for damaged data
        raise SourceError(path, f"is no pickle that can be read ({str(fault)[:200]}); {_WAY_OUT}") from None


def _check(data: bytes) -> None:
    """Raise an error for instructions that numbers do not need, and for memo indices far beyond those in use."""
    tuples = others = 0
    for count, (opcode, argument, _) in enumerate(pickletools.genops(data), 1):
        if opcode.name not in _OPCODES:
            raise _Refused(f"has the instruction {opcode.name}")
        if opcode.name in ("PUT", "BINPUT", "LONG_BINPUT") and not 0 <= int(str(argument)) <= count + 1:
            raise _Refused("numbers its parts beyond their count")
        if opcode.name == "GLOBAL" and "joblib" in str(argument):
            raise _Refused("was written by joblib, whose arrays lie beside the pickle")
        tuples += opcode.name.startswith("TUPLE")
        others += opcode.name in ("EMPTY_LIST", "EMPTY_DICT", "LIST", "DICT")
        if tuples > MAX_TUPLES or others > MAX_LISTS:
            raise _Refused(f"has more than {MAX_TUPLES} tuples, or more than {MAX_LISTS} lists")


def _plain(found: Mapping[Any, Any], depth: int) -> dict[str, Any]:
    """Convert values that can be arrays to arrays, keep nested dicts, and leave out the rest."""
    plain: dict[str, Any] = {}
    for key, value in found.items():
        if isinstance(value, dict) and depth:
            plain[str(key)[:200]] = _plain(value, depth - 1)
        elif isinstance(value, _Array):
            try:
                plain[str(key)[:200]] = value.array()
            except _Refused:
                continue  # a take may hold other values beside its numbers
        elif isinstance(value, (bool, int, float, str)):
            if not isinstance(value, int) or abs(value) < 1 << 62:  # Python's integers are unbounded
                plain[str(key)[:200]] = np.array(value)
        elif isinstance(value, list) and value and all(isinstance(item, float) for item in value):
            plain[str(key)[:200]] = np.array(value)
        elif isinstance(value, list) and value and all(isinstance(item, str) for item in value):
            # every text takes the room of the longest one
            plain |= {str(key)[:200]: np.array(value)} if len(value) * max(map(len, value)) <= MAX_LETTERS else {}
    return plain
