"""Ground truth files: what is read, and how each fault is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.labels.formats import ground_truth_files, read_labels


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "ground_truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_segments_are_read_with_their_lines_whatever_wrote_the_file(tmp_path: Path):
    path = written(tmp_path, "\ufefftake, class ,start,stop,remark\r\nt1,walk,0,12,\r\n\r\nt2, kick ,5,6,clear\r\n")
    segments = [(s.take, s.label, s.start, s.stop, s.line) for s in read_labels(path).segments]
    assert segments == [("t1", "walk", 0, 12, 2), ("t2", "kick", 5, 6, 4)]


def test_a_file_of_excel_has_semicolons_decimal_commas_and_windows_letters(tmp_path: Path):
    text = "sep=;\r\ntake;class;start_seconds;stop_seconds;remark\r\nt1;Fußtritt;0,5;12;a;b\r\n"
    for encoding in ("cp1252", "utf-8-sig", "utf-16"):
        (segment,) = read_labels(written(tmp_path, text.encode(encoding))).segments
        assert (segment.label, segment.start, segment.stop, segment.line) == ("Fußtritt", 0.5, 12.0, 3)


def test_a_row_of_a_take_alone_says_that_nothing_is_in_it(tmp_path: Path):
    path = written(tmp_path, "take,class,start,stop,remark\nt1,walk,0,12,\nt2,,,,looked at\nt1,,,,\n")
    found = read_labels(path)
    assert found.takes == ("t1", "t2")
    assert [segment.take for segment in found.segments] == ["t1"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("take,clas,start,stop\n", r"ground_truth.csv:1: has no column 'class'; did you mean 'clas'"),
        ("", r"ground_truth.csv:1: is empty"),
        ("take,class,start,stop\nt,walk,0,12\nt,walk,x,12\n", r"csv:3: start must be a source frame.*got 'x'"),
        ("take,class,start,stop\nt,walk,-1,12\n", r"csv:2: start must be.*got '-1'"),
        ("take,class,start,stop\nt,walk,3\n", r"csv:2: stop must be.*got ''"),
        (f"take,class,start,stop\nt,walk,0,{'9' * 5000}\n", r"csv:2: stop must be.*got '9{40}… \(5000 characters\)'"),
        ("take,class,start,stop\nt,walk,12,12\n", r"csv:2: start 12 must be before stop 12"),
        ("take,class,start,stop\nt,,0,12\n", r"csv:2: class is empty"),
        ("take,class,start,stop\nt,walk,,\n", r"csv:2: start must be.*got ''"),
        ("take,class,start,stop\n,walk,0,12\n", r"csv:2: take is empty"),
        (b"take,class,start,stop\nt,\x81,0,12\n", r"csv: is not UTF-8 text"),
    ],
)
def test_a_fault_is_named_with_file_and_line(tmp_path: Path, text: str | bytes, message: str):
    with pytest.raises(SourceError, match=message):
        read_labels(written(tmp_path, text))


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path):
    (tmp_path / "ground_truth.csv").mkdir()
    with pytest.raises(SourceError, match=r"ground_truth.csv: cannot be read: Is a directory"):
        read_labels(tmp_path / "ground_truth.csv")


def test_files_are_found_below_every_source_folder_or_by_their_own_path(tmp_path: Path):
    folders = [tmp_path / "a", tmp_path / "b" / "deep"]
    for folder in folders:
        folder.mkdir(parents=True)
        written(folder, "")
    roots = [tmp_path / "a", tmp_path / "b"]
    assert ground_truth_files("**/ground_truth.csv", roots) == [folder / "ground_truth.csv" for folder in folders]
    own = str(folders[1] / "ground_truth.csv")
    assert ground_truth_files(own, roots) == [folders[1] / "ground_truth.csv"]
    with pytest.raises(KinedexError, match=r"no file 'truth\.csv' below .*columns take, class, start, stop"):
        ground_truth_files("truth.csv", roots)
    for wrong in ("", "**.csv"):
        with pytest.raises(KinedexError, match="does not work as a path or glob"):
            ground_truth_files(wrong, roots)
    with pytest.raises(KinedexError, match="no longer there"):
        ground_truth_files("*.csv", [tmp_path / "gone"])
