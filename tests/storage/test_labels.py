"""Label files: what is written comes back to the frame, what others write is read, and every fault has its place."""

from __future__ import annotations

import csv
import json
import re
import unicodedata
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.labels.file_labels import Label, LabelsOfTake, ManualSegment
from kinedex.storage.formats.labels.formats import FORMATS, read_labels, write_labels

names = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs", "Zl", "Zp")), min_size=1, max_size=12).map(
    str.strip
)
names = names.filter(lambda name: bool(name) and not {"\ufffe", "\uffff"} & set(name))
classes = st.sampled_from(["walk", "kick & <turn>", 'a "b" (2)', "walk (2)", "--> x", "Größe", "NOTE", "=1+1"]) | names


@st.composite
def some_labels(draw: st.DrawFn) -> LabelsOfTake:
    frames = draw(st.integers(1, 2_000_000))
    made = []
    for _ in range(draw(st.integers(0, 8))):
        start = draw(st.integers(0, frames - 1))
        stop = draw(st.integers(start + 1, frames))
        made.append(Label(draw(classes), start, stop, None, draw(st.none() | st.floats(0, 1)), 1.0))
    rate = draw(st.sampled_from([25.0, 29.97, 30.0, 50.0, 59.94, 100.0, 120.0, 240.0, 480.0]))
    return LabelsOfTake(draw(names), rate, frames, tuple(sorted(made, key=lambda one: one.start)))


def by_time(segments: list[tuple[str, int, int]]) -> list[tuple[str, int, int]]:
    return sorted(segments, key=lambda one: (one[1], one[2], one[0]))


@settings(max_examples=60)
@given(some_labels(), st.sampled_from(sorted(FORMATS)))
def test_what_is_written_is_read_back_to_the_frame(tmp_path_factory, labels: LabelsOfTake, form: str):
    path = tmp_path_factory.mktemp("labels") / f"some.{form}"
    write_labels([labels], form, path)
    found = read_labels(path)
    expected = [(one.label, one.start, one.stop) for one in labels.labels]
    assert by_time([(one.label, *one.source_frames(labels.rate_hz)) for one in found.segments]) == by_time(expected)
    assert found.takes == (labels.take if form != "txt" else "some",)  # one without labels, too
    assert {one.take for one in found.segments} <= set(found.takes)


TWO = LabelsOfTake(
    "a take",
    120.0,
    1000,
    (Label("walk", 0, 120, "walkLeft", 0.1, 0.9), Label("walk", 60, 200), Label("kick & turn", 100, 300)),
    "2026-01-02T03:04:05Z",
)


def test_annotations_of_an_elan_tier_never_overlap_and_slots_ascend(tmp_path: Path):
    write_labels([TWO], "eaf", tmp_path)
    root = ElementTree.parse(tmp_path / "a take.eaf").getroot()
    assert [child.tag for child in root] == ["HEADER", "TIME_ORDER", "TIER", "TIER", "TIER", "LINGUISTIC_TYPE"]
    assert root.get("FORMAT") == "3.0"
    assert root.get("DATE") == "2026-01-02T03:04:05Z"
    assert [tier.get("TIER_ID") for tier in root.iter("TIER")] == ["kick & turn", "walk", "walk (2)"]
    assert [one.text for one in root.iter("ANNOTATION_VALUE")] == ["kick & turn", "walk", "walk"]
    times = [int(slot.get("TIME_VALUE", "")) for slot in root.iter("TIME_SLOT")]
    assert times == sorted(times) == [0, 500, 833, 1000, 1667, 2500]
    used = [one.get(f"TIME_SLOT_REF{end}") for one in root.iter("ALIGNABLE_ANNOTATION") for end in (1, 2)]
    assert sorted(map(str, used)) == [f"ts{number}" for number in range(1, 7)]


def test_the_same_labels_in_the_words_of_every_format(tmp_path: Path):
    for form in FORMATS:
        write_labels([TWO], form, tmp_path)
    text = {form: (tmp_path / f"a take.{form}").read_text() for form in FORMATS}
    assert text["txt"].splitlines()[0] == "0.000000\t1.000000\twalk"
    assert "3\n00:00:00.833 --> 00:00:02.500\nkick &amp; turn\n" in text["vtt"]
    assert text["csv"].splitlines()[1] == "a take,walk,walkLeft,0,120,0.0,1.0,0.1,0.9"
    (take,) = json.loads(text["json"])["takes"]
    assert (take["take"], take["source_rate_hz"], take["source_frames"]) == ("a take", 120, 1000)
    assert take["segments"][1]["cost"] is None


def test_nothing_is_overwritten_unless_asked_for_and_nothing_half_written(tmp_path: Path):
    others = [LabelsOfTake(name, 30.0, 9, ()) for name in ("one", "two")]
    written = list(write_labels(others, "vtt", tmp_path / "new" / "folder").paths)
    assert written == [tmp_path / "new" / "folder" / f"{name}.vtt" for name in ("one", "two")]
    before = written[1].stat().st_mtime_ns
    (tmp_path / "new" / "folder" / "one.vtt").unlink()
    with pytest.raises(KinedexError, match=r"two.vtt: there already; nothing is overwritten without --force"):
        write_labels(others, "vtt", tmp_path / "new" / "folder")
    assert not written[0].exists()
    assert written[1].stat().st_mtime_ns == before
    write_labels(others, "vtt", tmp_path / "new" / "folder", force=True)
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == ["one.vtt", "two.vtt"]
    with pytest.raises(KinedexError, match="holds one take, not 2; name a folder"):
        write_labels(others, "vtt", tmp_path / "all.vtt")
    assert list(write_labels(others, "json", tmp_path / "all.json").paths) == [tmp_path / "all.json"]
    with pytest.raises(KinedexError, match="no format of labels is named 'srt'"):
        write_labels(others, "srt", tmp_path)


def test_a_name_that_a_format_cannot_hold_excludes_its_take_and_no_other(tmp_path: Path):
    for name, form in (("a\nb", "vtt"), ("\x1b[31m", "eaf"), ("a\rb", "txt"), (" a", "csv"), ("", "json")):
        odd, plain = LabelsOfTake(name, 30.0, 9, ()), LabelsOfTake("plain", 30.0, 9, ())
        with pytest.raises(KinedexError, match=r"cannot hold .*would be read back differently"):
            write_labels([odd], form, tmp_path / f"x.{form}")
        written = write_labels([odd, plain], form, tmp_path / "folder", force=True)
        assert (written.excluded, [path.stem for path in written.paths]) == ((name,), ["plain"])


HOSTILE = (
    "a\nb", "a\rb", "\x1b[31mred", "\u202egnp", "\u200b", "=1+1", "+A1", "-x", "@x", "'=x", "''@x", "'x", "-3", "con",
    "a:b", "../up", "..", "A", "a", "x" * 400, 'q"uo,te', "\u00e4", "a\u0308",
)  # fmt: skip


@pytest.mark.parametrize("form", ["csv", "json"])
def test_any_name_is_exported_and_read_again(tmp_path: Path, form: str):
    takes = [LabelsOfTake(name, 30.0, 900, (Label(name, 0, 9, name, 0.1, 0.9),)) for name in HOSTILE]
    (whole,) = write_labels(takes, form, tmp_path / f"all.{form}").paths
    assert [(one.take, one.label) for one in read_labels(whole).segments] == [(name, name) for name in HOSTILE]
    written = write_labels(takes, form, tmp_path / "each")
    assert written.excluded == ()
    assert [read_labels(path).takes for path in written.paths] == [(name,) for name in HOSTILE]
    assert len({unicodedata.normalize("NFC", path.name).casefold() for path in written.paths}) == len(HOSTILE)
    assert all(re.fullmatch(r"[^\x00-\x1f/\\:*?\"<>|\u200b\u202e]{1,200}", path.name) for path in written.paths)
    assert {path.parent for path in written.paths} == {tmp_path / "each"}
    assert sorted(written.renamed) == sorted(
        set(HOSTILE) - {"=1+1", "+A1", "-x", "@x", "'=x", "''@x", "'x", "-3", "A", "\u00e4"}
    )


def test_a_spreadsheet_computes_no_cell(tmp_path: Path):
    takes = [LabelsOfTake(name, 30.0, 900, (Label(name, 0, 9, name, -0.5, 0.9),)) for name in HOSTILE]
    (path,) = write_labels(takes, "csv", tmp_path / "all.csv").paths
    with path.open(encoding="utf-8", newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    assert not [cell for cell in cells if cell[:1] in tuple("=+-@\t\r") and not re.fullmatch(r"-[0-9.]+", cell)]
    assert "-0.5" in cells


def read(folder: Path, ending: str, text: str) -> list[ManualSegment]:
    path = folder / f"mine.{ending}"
    path.write_text(text, encoding="utf-8", newline="")
    return list(read_labels(path).segments)


def test_what_is_a_folder_and_which_format_is_meant(tmp_path: Path):
    takes = [LabelsOfTake(name, 30.0, 9, ()) for name in ("one", "two")]
    year = tmp_path / "lab.2024"
    with pytest.raises(
        KinedexError, match=r"2024: its ending, '\.2024', is no format of labels.*folder.*--format.*a / at"
    ):
        write_labels(takes, None, year)
    with pytest.raises(KinedexError, match=r"labels\.cvs: .* '\.cvs', is no .*; did you mean 'csv'"):
        write_labels(takes, None, tmp_path / "labels.cvs")
    assert list(tmp_path.iterdir()) == []
    assert list(write_labels(takes, None, f"{year}/").paths) == [year / "one.csv", year / "two.csv"]
    assert list(write_labels(takes, None, year, force=True).paths) == [
        year / "one.csv",
        year / "two.csv",
    ]  # it is a folder now
    assert list(write_labels(takes, "VTT", year).paths) == [year / "one.vtt", year / "two.vtt"]
    assert list(write_labels(takes, None, f"{tmp_path}/in.csv/").paths) == [
        tmp_path / "in.csv" / f"{n}.csv" for n in ("one", "two")
    ]
    assert list(write_labels(takes, None, tmp_path / "plain").paths) == [
        tmp_path / "plain" / f"{n}.csv" for n in ("one", "two")
    ]
    assert list(write_labels(takes, None, tmp_path / "all.JSON").paths) == [tmp_path / "all.JSON"]


def test_where_nothing_can_be_written_the_target_is_named(tmp_path: Path):
    (tmp_path / "p.yaml").touch()
    for output, form in (
        (tmp_path / "p.yaml" / "x.csv", None),
        (tmp_path / "p.yaml", "csv"),
        (f"{tmp_path}/p.yaml/", None),
    ):
        with pytest.raises(KinedexError, match=r"p\.yaml: is no folder, so .* cannot be written into it"):
            write_labels([TWO], form, output)
    assert (tmp_path / "p.yaml").read_text() == ""
    with pytest.raises(KinedexError, match=r"x\.csv: cannot be written: File name too long"):
        write_labels([TWO], "csv", tmp_path / f"{'x' * 300}.csv")
    (tmp_path / "taken.csv" / "a take.csv").mkdir(parents=True)
    with pytest.raises(KinedexError, match=r"a take\.csv: cannot be written: Is a directory"):
        write_labels([TWO], "csv", tmp_path / "taken.csv", force=True)
    assert not list(tmp_path.rglob(".tmp-*"))


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no folder that nobody may write into")
def test_a_folder_that_nobody_may_write_into_is_not_blamed_on_a_temporary_file():
    with pytest.raises(KinedexError, match=r"^/proc/labels\.csv: cannot be written: "):
        write_labels([TWO], None, "/proc/labels.csv")


def test_takes_without_a_label_are_takes_of_their_file(tmp_path: Path):
    takes = [TWO, LabelsOfTake("found empty", 30.0, 9, ())]
    for form in ("csv", "json"):
        (path,) = write_labels(takes, form, tmp_path / f"all.{form}").paths
        found = read_labels(path)
        assert found.takes == ("a take", "found empty")
        assert {one.take for one in found.segments} == {"a take"}
    assert (tmp_path / "all.csv").read_text().splitlines()[-1] == "found empty,,,,,,,,"
    (tmp_path / "mine.txt").touch()
    (tmp_path / "theirs.vtt").write_text("WEBVTT\n")
    assert read_labels(tmp_path / "mine.txt").takes == ("mine",)
    assert read_labels(tmp_path / "theirs.vtt").takes == ("theirs",)
    (tmp_path / "none.json").write_text('{"takes": []}')
    assert read_labels(tmp_path / "none.json").takes == ()


def eaf(tiers: str, slots: str = "", head: str = "") -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n{head}<ANNOTATION_DOCUMENT>\n<HEADER TIME_UNITS="milliseconds"/>\n'
        f'<TIME_ORDER><TIME_SLOT TIME_SLOT_ID="a" TIME_VALUE="100"/><TIME_SLOT TIME_SLOT_ID="b" TIME_VALUE="260"/>'
        f'<TIME_SLOT TIME_SLOT_ID="c"/>{slots}</TIME_ORDER>\n{tiers}\n</ANNOTATION_DOCUMENT>'
    )


def tier(name: str, value: str, ends: str = "ab", more: str = "") -> str:
    return (
        f'<TIER TIER_ID="{name}" {more}><ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="n1" '
        f'TIME_SLOT_REF1="{ends[0]}" TIME_SLOT_REF2="{ends[1]}"><ANNOTATION_VALUE>{value}</ANNOTATION_VALUE>'
        "</ALIGNABLE_ANNOTATION></ANNOTATION></TIER>"
    )


def test_elan_values_are_classes_and_tiers_where_there_is_no_value(tmp_path: Path):
    found = read(
        tmp_path, "eaf", eaf(tier("motion", "walk") + tier("kick", " ") + tier("x", "sure?", more='PARENT_REF="kick"'))
    )
    assert [(one.take, one.label, one.start, one.stop) for one in found] == [
        ("mine", "walk", 0.1, 0.26),
        ("mine", "kick", 0.1, 0.26),
    ]
    assert found[0].source_frames(120.0) == (12, 31)  # 31.2 is nearest to 31
    assert found[0].where == f"{tmp_path / 'mine.eaf'}:5: annotation n1"


BOMB = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>\n'
OUTSIDE = '<!DOCTYPE x SYSTEM "file:///etc/passwd">\n'


@pytest.mark.parametrize(
    ("ending", "text", "message"),
    [
        ("eaf", eaf("", head=BOMB), r"mine.eaf:2: has a document type declaration"),
        ("eaf", eaf("", head=OUTSIDE), r"mine.eaf:2: has a document type declaration"),
        ("eaf", eaf(tier("a", "&b;")), r"mine.eaf:5: is not XML: undefined entity"),
        ("eaf", eaf("<TIER"), r"mine.eaf:6: is not XML"),
        ("eaf", "<html/>", r"mine.eaf:1: is no EAF file"),
        ("eaf", "", r"is not XML"),
        ("eaf", eaf(tier("a", "b", "ba")), r"mine.eaf:5: annotation n1: start 260 ms must be before stop 100 ms"),
        ("eaf", eaf(tier("a", "b", "ac")), r"mine.eaf:5: annotation n1 ends at the time slot c, which has no time"),
        ("eaf", eaf(tier("a", "b", "ax")), r"mine.eaf:5: annotation n1 names the time slot x, which is not there"),
        ("eaf", eaf("", '<TIME_SLOT TIME_SLOT_ID="d" TIME_VALUE="1.5"/>'), r":4: TIME_VALUE must be milli.*1\.5"),
        ("eaf", eaf("").replace("milliseconds", "PAL-frames"), r":3: TIME_UNITS must be milli.*'PAL-frames'"),
        ("vtt", "00:01.000 --> 00:02.000\nwalk\n", r"mine.vtt:1: is no WebVTT file"),
        ("vtt", "WEBVTT\n\n1\n00:01.000 --> 00:02\nwalk\n", r"mine.vtt:4: expected times such as"),
        ("vtt", "WEBVTT\n\n00:02.000 --> 00:02.000\nwalk\n", r"mine.vtt:3: start 2 s must be before stop 2 s"),
        ("vtt", "WEBVTT\n\n00:01.000 --> 00:02.000\n", r"mine.vtt:3: the cue has no text"),
        ("vtt", "WEBVTT\n\nwalk\n", r"mine.vtt:4: expected times|mine.vtt:3: expected times"),
        ("txt", "0\t1\twalk\n1 2 walk\n", r"mine.txt:2: expected start, stop and label separated by tabs, got '1 2"),
        ("txt", "0,5\t1\twalk\n", r"mine.txt:1: expected seconds such as 12.5, got '0,5'"),
        ("txt", "1\t1\twalk\n", r"mine.txt:1: start 1 s must be before stop 1 s"),
        ("txt", "1\t2\t \n", r"mine.txt:1: the label has no text"),
        ("json", "{", r"mine.json:1: is not JSON"),
        ("json", "[" * 100_000, r"is nested too deeply|is not JSON"),
        ("json", '{"takes": [{"take": "a", "segments": 1}]}', r"takes\[0\] must be an object with a list 'segments'"),
        (
            "json",
            '{"takes": [{"take": "a", "segments": [{"class": "b", "start": 0.5, "stop": 2}]}]}',
            r"takes\[0\]\.segments\[0\]\.start must be a source frame, a whole number from 0, got 0.5",
        ),
        (
            "json",
            '{"takes": [{"take": "a", "segments": [{"class": "b", "start": 5, "stop": 2}]}]}',
            r"takes\[0\]\.segments\[0\]: start 5 must be before stop 2",
        ),
        ("csv", "take,class,start_seconds,stop_seconds\na,b,-1,2\n", r"csv:2: start_seconds must be seconds from 0"),
        ("srt", "", r"mine.srt: is not read as labels: the ending must be one of .csv \(CSV\)"),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_line_or_element(tmp_path: Path, ending: str, text: str, message: str):
    with pytest.raises(SourceError, match=message):
        read(tmp_path, ending, text)


def test_what_other_programs_write_is_read(tmp_path: Path):
    audacity = "\ufeff0.5\t1.25\twalk \r\n\\\t100.0\t2000.0\r\n3.000000\t4.5\tkick\tleft\r\n"
    assert [(one.label, one.start, one.stop, one.line) for one in read(tmp_path, "txt", audacity)] == [
        ("walk", 0.5, 1.25, 1),
        ("kick\tleft", 3.0, 4.5, 3),
    ]
    video = (
        "WEBVTT - my labels\r\nKind: captions\r\n\r\nSTYLE\r\n::cue { color: red }\r\n\r\nNOTE\r\nmine\r\n\r\n"
        "01:00:01.000 --> 01:00:02.500 align:start\r\n<v Ann>walk</v> &amp; turn\r\nkick\r\n"
    )
    assert [(one.take, one.label, one.start, one.line) for one in read(tmp_path, "vtt", video)] == [
        ("mine", "walk & turn", 3601.0, 11),
        ("mine", "kick", 3601.0, 12),
    ]
    table = "take,class,start_seconds,stop_seconds\na,walk,0.5,.75\n"
    (one,) = read(tmp_path, "csv", table)
    assert one.source_frames(120.0) == (60, 90)
    (one,) = read(tmp_path, "json", '{"takes": [{"take": "a", "segments": [{"class": "b", "start": 1, "stop": 2}]}]}')
    assert (one.start, one.stop, one.in_seconds, one.line) == (1, 2, False, None)
    assert "takes[0].segments[0]: too long" in str(one.error("too long"))


@pytest.mark.parametrize("form", ["csv", "json", "eaf"])
def test_limbs_and_annotators_come_back(tmp_path: Path, form: str):
    labels = (
        Label("error", 0, 50, limb="lshank", annotator="A1"),
        Label("error", 20, 60, limb="lshank", annotator="A1"),
        Label("error", 20, 60, limb="rhand"),
        Label("walk", 0, 100),
    )
    write_labels([LabelsOfTake("a take", 100.0, 500, labels)], form, tmp_path / f"some.{form}")
    found = read_labels(tmp_path / f"some.{form}").segments
    assert {(one.label, one.limb, one.annotator, *one.source_frames(100.0)) for one in found} == {
        (one.label, one.limb, one.annotator, one.start, one.stop) for one in labels
    }


@pytest.mark.parametrize(("form", "label"), [("eaf", "walk"), ("vtt", "error"), ("txt", "error")])
def test_a_format_without_a_place_for_the_limb_is_refused(tmp_path: Path, form: str, label: str):
    labels = LabelsOfTake("a take", 100.0, 500, (Label(label, 0, 50, limb="lshank"),))
    with pytest.raises(KinedexError, match=f"has no place for the limb of a label '{label}' \\(a take, lshank\\)"):
        write_labels([labels], form, tmp_path / f"some.{form}")
    assert not list(tmp_path.iterdir())
