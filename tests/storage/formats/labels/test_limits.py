"""Label files beyond the limits are refused with size and limit, and no file takes time or memory out of proportion."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from kinedex.ops.errors import SourceError
from kinedex.storage.formats import source_files
from kinedex.storage.formats.labels import elan, label_tables, texts, webvtt
from kinedex.storage.formats.labels.formats import FORMATS, read_labels

EAF = (
    '<?xml version="1.0"?><ANNOTATION_DOCUMENT><HEADER TIME_UNITS="milliseconds"/><TIME_ORDER>'
    '<TIME_SLOT TIME_SLOT_ID="a" TIME_VALUE="0"/><TIME_SLOT TIME_SLOT_ID="b" TIME_VALUE="10"/></TIME_ORDER>'
    '<TIER TIER_ID="{tier}"><ANNOTATION><ALIGNABLE_ANNOTATION TIME_SLOT_REF1="a" TIME_SLOT_REF2="b">'
    "<ANNOTATION_VALUE>{value}</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION></TIER></ANNOTATION_DOCUMENT>"
)
CUE = "WEBVTT\n\n00:01.000 --> 00:02.000\n{text}\n"
ONE = {
    "csv": "take,class,start,stop\n{take},{text},0,5\n",
    "json": '{{"takes": [{{"take": "{take}", "segments": [{{"class": "{text}", "start": 0, "stop": 5}}]}}]}}',
    "eaf": EAF.replace("{tier}", "t").replace("{value}", "{text}"),
    "vtt": CUE,
    "txt": "0.0\t1.0\t{text}\n",
}
"""A file of one label in every format."""


def write(folder: Path, ending: str, text: str) -> Path:
    path = folder / f"x.{ending}"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, ending: str, text: str) -> str:
    with pytest.raises(SourceError) as found:
        read_labels(write(folder, ending, text))
    return found.value.reason


@pytest.mark.parametrize("ending", FORMATS)
def test_a_file_beyond_the_size_is_refused_before_it_is_read(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"x.{ending}"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 3 * source_files.MAX_BYTES)
    with pytest.raises(SourceError, match=r"has 192\.0 MB; label files have at most 64 MB: divide it by takes"):
        read_labels(path)


@pytest.mark.parametrize("ending", FORMATS)
def test_long_texts_are_read_up_to_the_limit(tmp_path: Path, ending: str) -> None:
    form = ONE[ending]
    (label,) = read_labels(write(tmp_path, ending, form.format(take="t", text="x" * texts.MAX_LETTERS))).segments
    assert len(label.label) == texts.MAX_LETTERS
    reason = refusal(tmp_path, ending, form.format(take="t", text="x" * (texts.MAX_LETTERS + 1)))
    assert "has 100,001 characters or more; a class or a take's name has at most 100,000" in reason


@pytest.mark.parametrize(
    ("ending", "head", "row"),
    [
        ("csv", "take,class,start,stop\n", "t,walk,{0},{1}\n"),
        ("vtt", "WEBVTT\n\n", "00:{0:02d}.000 --> 00:{1:02d}.000\nwalk\n\n"),
        ("txt", "", "{0}.0\t{1}.0\twalk\n"),
    ],
)
def test_more_labels_than_the_limit_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, head: str, row: str
) -> None:
    monkeypatch.setattr(texts, "MAX_LABELS", 10)
    rows = [row.format(number, number + 1) for number in range(11)]
    assert len(read_labels(write(tmp_path, ending, head + "".join(rows[:10]))).segments) == 10
    assert "has more than 10 labels, the most of one file" in refusal(tmp_path, ending, head + "".join(rows))


def test_more_labels_than_the_limit_are_refused_in_json_and_eaf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(texts, "MAX_LABELS", 10)
    one = '{"class": "walk", "start": 0, "stop": 5}'
    many = '{{"takes": [{{"take": "t", "segments": [{}]}}]}}'.format(", ".join([one] * 11))
    assert "has more than 10 labels" in refusal(tmp_path, "json", many)
    before, value, after = EAF.format(tier="t", value="walk").partition("<ANNOTATION>")
    part = value + after.partition("</TIER>")[0]
    assert "has more than 10 labels" in refusal(tmp_path, "eaf", before + 11 * part + "</TIER></ANNOTATION_DOCUMENT>")
    slots = "".join(f'<TIME_SLOT TIME_SLOT_ID="ts{i}" TIME_VALUE="{i}"/>' for i in range(30))
    assert "has more than 10 labels" in refusal(tmp_path, "eaf", f"<ANNOTATION_DOCUMENT>{slots}")


def test_lists_and_objects_of_json_are_counted_before_they_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(label_tables, "_MAX_VALUES", 1000)
    reason = refusal(tmp_path, "json", '{"takes": [' + "[]," * 1000 + "0]}")
    assert "has 1,002 lists and objects; JSON files of labels have at most 1,000" in reason


@pytest.mark.parametrize(
    "text", ["[" * 1_000_000, '{"a":' * 500_000, '{"takes": ' + "[" * 200_000 + "]" * 200_000 + "}"]
)
def test_deep_json_is_refused(tmp_path: Path, text: str) -> None:
    assert "nested too deeply" in refusal(tmp_path, "json", text)


@pytest.mark.parametrize("number", ["1e999999", "-1e999999", "9" * 400, "9" * 100_000, "0." + "9" * 100_000 + "e400"])
def test_huge_numbers_of_json_are_refused(tmp_path: Path, number: str) -> None:
    text = f'{{"takes": [{{"take": "t", "segments": [{{"class": "a", "start": 0, "stop": {number}}}]}}]}}'
    assert refusal(tmp_path, "json", text)


def test_deep_xml_is_refused(tmp_path: Path) -> None:
    deep = EAF.format(tier="t", value="<b>" * 100_000 + "</b>" * 100_000)
    assert f"elements in more than {elan.DEEPEST} levels" in refusal(tmp_path, "eaf", deep)


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE a [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]>',
        '<!DOCTYPE a SYSTEM "file:///etc/passwd">',
        '<!DOCTYPE a [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>',
        '<!DOCTYPE a [<!ATTLIST a b CDATA "c">]>',
    ],
)
def test_entities_and_declarations_are_refused(tmp_path: Path, doctype: str) -> None:
    text = EAF.format(tier="t", value="&b;").replace("<ANNOTATION_DOCUMENT>", f"{doctype}<ANNOTATION_DOCUMENT>")
    assert "has a document type declaration" in refusal(tmp_path, "eaf", text)


def test_text_between_thousands_of_inner_elements_is_joined_once(tmp_path: Path) -> None:
    text = "a\n" * 25_000 + "<b/>" * 200_000
    (label,) = read_labels(write(tmp_path, "eaf", EAF.format(tier="t", value=text))).segments
    assert label.label == ("a\n" * 25_000).strip()


def test_attributes_and_namespaces_by_the_thousand_are_read(tmp_path: Path) -> None:
    names = " ".join(f'xmlns:n{i}="urn:{i}" a{i}="1"' for i in range(20_000))
    (label,) = read_labels(write(tmp_path, "eaf", EAF.format(tier="t", value=f"walk<n1:b {names}/>"))).segments
    assert label.label == "walk"


def test_references_of_thousands_of_digits_are_refused(tmp_path: Path) -> None:
    digits = "&#" + "9" * 5000 + ";"
    assert "a reference has thousands of digits" in refusal(tmp_path, "vtt", CUE.format(text=digits))
    note = f"WEBVTT\n\nNOTE\nkinedex take: {digits}\n"
    assert "a reference has thousands of digits" in refusal(tmp_path, "vtt", note)


def test_blocks_of_lines_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webvtt, "MAX_LABELS", 10)
    assert "has more than 10 lines without a blank one" in refusal(tmp_path, "vtt", "WEBVTT\n\nNOTE\n" + "a\n" * 20)


@pytest.mark.parametrize("ending", ["csv", "vtt", "txt"])
def test_all_ends_of_lines_are_read_alike(tmp_path: Path, ending: str) -> None:
    text = ONE[ending].format(take="t", text="walk")
    found = []
    for end in ("\n", "\r\n", "\r"):
        path = tmp_path / f"x.{ending}"
        path.write_bytes(text.replace("\n", end).encode())
        found.append(read_labels(path))
    assert found[0] == found[1] == found[2]
