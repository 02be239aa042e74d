"""Pickles: arrays of every protocol and of Python 2 come in as they are, and nothing in a file can run."""

from __future__ import annotations

import builtins
import collections
import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import numpy_arrays
from kinedex.storage.formats.motion.numpy_arrays import load_pickle

ARRAYS: dict[str, Any] = {
    "trans": np.arange(12.0).reshape(4, 3),
    "small": np.arange(6, dtype=np.float32)[::-1].reshape(2, 3),
    "big_endian": np.arange(3, dtype=">i4"),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "empty": np.zeros((0, 72)),
    "gender": "female",
    "fps": 30,
    "scale": np.float64(93.5),
    "nested": {"betas": np.ones(10), "list": [1.0, 2.0]},
}


def save(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def refused(path: Path, content: bytes, *words: str) -> None:
    with pytest.raises(SourceError) as caught:
        load_pickle(save(path, content))
    for word in (*words, "numpy.savez"):
        assert word in str(caught.value)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_of_every_protocol_come_in_as_they_are(tmp_path: Path, protocol: int) -> None:
    content = pickle.dumps(ARRAYS, protocol)
    if protocol < 2:  # as latin-1 of text, which Python 2 and the oldest protocols have
        content = content.replace(b"cnumpy._core", b"cnumpy.core")
    found = load_pickle(save(tmp_path / "a.pkl", content))
    for name, value in ARRAYS.items():
        if isinstance(value, dict):
            for key, inner in value.items():
                np.testing.assert_array_equal(found[name][key], inner)
        else:
            np.testing.assert_array_equal(found[name], value)
    assert found["big_endian"].dtype.byteorder in (">", "=")


def python_2(array: np.ndarray) -> bytes:
    """A dict with one array as Python 2 pickled it in protocol 2: its bytes are a text."""
    data = array.tobytes()
    text = b"T" + struct.pack("<I", len(data)) + data
    return (
        b"\x80\x02}q\x00U\x05posesq\x01cnumpy.core.multiarray\n_reconstruct\nq\x02"
        b"cnumpy\nndarray\nq\x03K\x00\x85q\x04U\x01bq\x05\x87"
        b"q\x06Rq\x07(K\x01K" + bytes([len(array)]) + b"K" + bytes([array.shape[1]])
        + b"\x86cnumpy\ndtype\nq\x08U\x02f8q\tK\x00K"
        b"\x01\x87q\nRq\x0b(K\x03U\x01<q\x0cNNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tq\rb\x89" + text + b"tq\x0ebs."
    )  # fmt: skip


def test_pickles_of_python_2_come_in(tmp_path: Path) -> None:
    array = np.random.default_rng(0).normal(size=(5, 72))
    np.testing.assert_array_equal(load_pickle(save(tmp_path / "a.pkl", python_2(array)))["poses"], array)


class Call:
    """An object whose pickle calls a function."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.reduced = (function, arguments)

    def __reduce__(self) -> Any:
        return self.reduced


RAN: list[str] = []


def run(text: str = "") -> str:
    """Note that a pickle has reached a function."""
    RAN.append(text)
    return text


MALICIOUS = {
    "a command": (Call(os.system, "touch ran"), "asks for"),
    "eval": (Call(eval, "__import__('os')"), "asks for builtins.eval"),
    "exec": (Call(exec, "import os"), "asks for builtins.exec"),
    "getattr": (Call(getattr, "", "join"), "asks for builtins.getattr"),
    "a function of the tests": (Call(run, "x"), "asks for"),
    "numpy.load": (Call(np.load, "x"), "asks for numpy.load"),
    "numpy.fromfile": (Call(np.fromfile, "/etc/passwd"), "asks for"),
    "a method": (Call(str.join, "", []), "asks for builtins.getattr"),
    "a counter": (collections.Counter("aab"), "asks for collections.Counter"),
    "a path": (Path("x"), "asks for pathlib"),
    "an array of objects": ({"poses": np.array([Call(os.system, "touch ran")], dtype=object)}, "asks for"),
    "a set": ({"poses": {1, 2}}, "instruction"),
    "a list": ([np.ones(3)], "holds no dict"),
    "joblib": (b"\x80\x03cjoblib.numpy_pickle\nNumpyArrayWrapper\n.", "joblib"),
    "gzip": (b"\x1f\x8b\x08\x00", "packed by gzip"),
    "zlib": (b"\x78\x9c\x08\x00", "packed by zlib"),
    "an extension": (b"\x80\x02\x82\x01.", "instruction EXT1"),
    "a persistent id": (b"Psomewhere\n.", "instruction PERSID"),
    "an instance": (b"(S'id'\nios\nsystem\n.", "instruction INST"),
    "a bomb of bytes": (Call(bytes, 1 << 40), "asks for bytes of its choice"),
    "a place far out": (b"\x80\x02}r\xff\xff\xff\x7f.", "numbers its parts beyond"),
    "a changed function": (b"\x80\x02cnumpy\ndtype\n}U\x04codeK\x01sb.", "changes a function"),
    "a changed function, by slots": (b"\x80\x02cnumpy\ndtype\nN}U\x05_makeK\x01s\x86b.", "changes a function"),
    "tuples in tuples": (b"\x80\x02)" + b"\x85" * 100_000 + b"K\x01s.", "tuples"),
    "an array of 2^60 numbers": (
        b"\x80\x02}U\x05posescnumpy.core.multiarray\n_reconstruct\n)R(K\x01\x8a\x08" + b"\x00" * 7
        + b"\x10\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R\x89U\x01xtbs.", "",
    ),
    "a text of 2^40 bytes": (b"\x80\x04\x8e" + struct.pack("<Q", 1 << 40) + b"x.", "no pickle that can be read"),
    "cut off": (pickle.dumps(ARRAYS)[:-20], "no pickle that can be read"),
    "no pickle": (b"hello", "instruction OBJ"),
    "a number without end": (b"L" + b"9" * 1_000_000 + b"L\n.", "no pickle that can be read"),
}  # fmt: skip
"""Name → what is pickled, or its bytes, and words of the refusal; none for files whose harmful part is not used."""


@pytest.mark.parametrize("name", MALICIOUS)
def test_no_pickle_runs_anything_or_takes_more_than_its_bytes(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    what, words = MALICIOUS[name]
    content = what if isinstance(what, bytes) else pickle.dumps(what)
    monkeypatch.chdir(tmp_path)
    if words:
        refused(tmp_path / "a.pkl", content, words)
    else:
        assert load_pickle(save(tmp_path / "a.pkl", content)) == {}
    assert not (tmp_path / "ran").exists()
    assert not RAN


def test_functions_are_made_anew_for_every_file() -> None:
    """A file that could change one would not reach the next file's."""
    unpickler = numpy_arrays._Unpickler(__import__("io").BytesIO(b""))
    first, second = (unpickler.find_class("numpy", "dtype") for _ in range(2))
    assert first is not second
    for name in ("system", "popen"):
        with pytest.raises(numpy_arrays._Refused):
            unpickler.find_class("os", name)
    for name in set(dir(builtins)) - {"bytes"}:
        with pytest.raises(numpy_arrays._Refused):
            unpickler.find_class("builtins", name)
