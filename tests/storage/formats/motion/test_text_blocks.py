"""Long text files are parsed in blocks: bodies, warnings and errors are those of the file as a whole."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import text_blocks
from kinedex.storage.formats.motion.reader import ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.text_blocks import Block, after_last_line, before_last_frame, blocks
from tests.bvh_files import bvh_text, dance, mixamo
from tests.pipelines.archives import human_amc, human_asf

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)
AMC = human_amc(40, 1)
BVH = bvh_text(mixamo(), dance(mixamo(), 40))
CLAIM = re.compile(r"Frames: \d+")

TEXTS = {
    "whole": AMC, "whole.bvh": BVH,
    "from frame 9": AMC.replace("\n", "\n# no motion\n", 3)[: AMC.index("\n1\n")] + AMC[AMC.index("\n9\n") :],
    "a missing frame": AMC[: AMC.index("\n20\n")] + AMC[AMC.index("\n22\n") :],
    "a missing bone": AMC.replace("\n30\n", "\n", 1),
    "a bone missing at a frame's end": re.sub(r"\nrfingers [^\n]*\n25\n", "\n25\n", AMC),
    "a bad number": AMC.replace("\n33\n", "\n33x\n"),
    "cut off": AMC[:-30], "cut off after a line": AMC[: AMC.rindex("rfingers")],
    "numbers that need care": re.sub(r"(\d\.\d{4})\b", r"\g<1>123456789012345678", AMC),
    "nothing.bvh": BVH[: BVH.index("Frame Time: 0.0333333\n") + 22], "blanks": " \n\t\n" * 500,
    "blanks.bvh": " \n" * 900,
    "cut off.bvh": BVH[:-40], "cut off with blanks.bvh": BVH[:-40] + "\n \n\n" * 300,
    "a short line.bvh": re.sub(r"\n(\S+ )(.*\n.*\n)$", r"\n\2", BVH),
    "a long line.bvh": BVH[:-1] + " 1\n", "a bad number.bvh": BVH[:-4] + "x\n" + "\n# a comment\n" * 50,
    "no last end.bvh": CLAIM.sub("Frames: 39", BVH).rstrip("\n"), "a wrong count.bvh": CLAIM.sub("Frames: 999", BVH),
    "no hierarchy.bvh": BVH.replace("HIERARCHY", "HIERARCHIE"), "no end of the hierarchy.bvh": BVH.replace("}", ""),
}  # fmt: skip


def read(folder: Path, name: str, text: str) -> object:
    """Return all that is read of a text: the numbers and words of a body, or line and reason of the error."""
    path = folder / (name if name.endswith(".bvh") else f"{name}.amc")
    path.write_bytes(text.encode())
    (folder / "x.asf").write_text(human_asf())
    asf = folder / "x.asf" if path.suffix == ".amc" else None
    try:
        body = read_body(path, asf, AUTO, JOINTS, ReadSettings())
    except SourceError as fault:
        return fault.line, fault.reason
    return body.positions.tobytes(), body.orientation.tobytes(), body.rate_hz, body.unit, body.warnings


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["LF", "CR LF", "CR"])
@pytest.mark.parametrize("name", TEXTS)
def test_blocks_of_any_size_give_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, end: str) -> None:
    text = TEXTS[name].replace("\n", end)
    whole = read(tmp_path, name, text)
    for size in (701, 2900, 30_000):
        monkeypatch.setattr(text_blocks, "BLOCK", size)
        assert read(tmp_path, name, text) == whole


def test_a_header_line_or_frame_that_does_not_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_blocks, "BLOCK", 1 << 16)
    monkeypatch.setattr(text_blocks, "LONGEST", 1 << 20)
    long = "1 " * (1 << 20)
    for name, text in (("a", ":FULLY\n" + long), ("a.bvh", BVH + long), ("b", AMC + "root 1\n" * (1 << 18))):
        found = read(tmp_path, name, text)
        assert isinstance(found, tuple)
        assert found[1] == "has a header, a frame or a line of more than 1 MB"


def test_blocks_join_to_the_file_and_know_their_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    random = np.random.default_rng(0)

    def pieces(data: bytes, size: int) -> Iterator[Block]:
        path.write_bytes(data)
        monkeypatch.setattr(text_blocks, "BLOCK", size)
        return blocks(path, None, random.choice([after_last_line, before_last_frame]))

    for _ in range(300):
        data = b"a" + bytes(random.choice([*b"\n\r\n\r12a "], 60).tolist())
        before, lasts = b"", []
        for block in pieces(data, int(random.integers(1, 30))):
            assert block.start == len(before)
            assert block.line == len(re.findall(rb"\r\n?|\n", before)) + 1
            before += block.data
            lasts.append(block.last)
        assert before == data
        assert lasts == [False] * (len(lasts) - 1) + [True]


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_blocks, "BLOCK", 3000)
    path = tmp_path / "a.bvh"
    path.write_text(BVH)
    from kinedex.storage.formats.motion.bvh_parser import BvhFile

    real = BvhFile.blocks

    def grow(file: BvhFile) -> Iterator[np.ndarray]:
        path.write_text(BVH + BVH.splitlines()[-1] + "\n")
        return real(file)

    monkeypatch.setattr(BvhFile, "blocks", grow)
    with pytest.raises(SourceError, match="was changed while it was read"):
        read_body(path, None, AUTO, JOINTS)
