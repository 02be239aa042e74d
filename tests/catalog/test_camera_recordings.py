"""The file of recordings: what its keys must be, with line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.catalog.camera_recordings import load_recordings, parse_recordings
from kinedex.catalog.configs import parse_yaml
from kinedex.ops.errors import ConfigError

GOOD = "recordings:\n  a: {cameras: c.toml, keypoints: 'p/{camera}/*.json', rate_hz: 60%s}\n"


def test_a_recording_has_defaults() -> None:
    found = parse_recordings(parse_yaml(GOOD % ", person: 3, offsets: {x: -2}", "/tmp/r.yaml")).entry("a")
    assert (found.person, found.body, found.up, found.cuts, found.offsets) == ("3", "estimate", None, [], {"x": -2})


def test_a_track_of_the_store_needs_nothing_else() -> None:
    assert parse_recordings(parse_yaml("recordings: {a: {track: bad_01}}", "r.yaml")).entry("a").track == "bad_01"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD % ", rate: 3", "r.yaml:2: recordings.a.rate: no such key; did you mean 'rate_hz'"),
        (GOOD.replace("60", "0") % "", "r.yaml:2: recordings.a.rate_hz: must be greater than 0, got 0"),
        (GOOD.replace("60", ".nan") % "", "rate_hz: must be a finite number, got nan"),
        (GOOD % ", up: w", "recordings.a.up: must be 'x', 'y', 'z', '-x', '-y' or '-z', got 'w'"),
        (GOOD % ", unit: km", "recordings.a.unit: must be 'm', 'cm', 'mm' or 'in', got 'km'"),
        (GOOD % ", size: [0, 5]", r"size\[0\]: must be greater than 0, got 0"),
        (GOOD % ", cuts: [-1]", r"cuts\[0\]: must be greater than or equal to 0, got -1"),
        (GOOD % ", track: b", "recordings.a.cameras: must not stand beside `track`"),
        ("recordings: {a: {cameras: c.toml, rate_hz: 3}}", "must have `keypoints` or `silhouettes`"),
        ("recordings: {a: {keypoints: c.csv, rate_hz: 3}}", "must have `cameras`, the file of their calibration"),
        ("recordings: {a: {keypoints: c.csv, cameras: c.toml}}", "must have `rate_hz`"),
        ("recordings: {../x: {track: b}}", "a recording's name must be 1 to 100 letters"),
        ("recordings: {3: {track: b}}", "got '3'; put numbers in quotes"),
        ("recordings: []", "expected a mapping of names to recordings"),
        ("a: {track: b}", "r.yaml:1: a: no such key; recordings stand under `recordings`"),
    ],
)
def test_wrong_files_are_refused_with_line_and_key(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_recordings(parse_yaml(text, "r.yaml"))


def test_a_name_that_is_not_there_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="no recording is called 'b'; known: a"):
        parse_recordings(parse_yaml(GOOD % "", "r.yaml")).entry("b")


def test_a_path_to_something_else_is_refused_with_what_is_expected(tmp_path: Path) -> None:
    (tmp_path / "calib.toml").write_text("[cam_1]\n")
    for name, found in (("none.yaml", "no such file"), ("", "is a folder"), ("calib.toml", "is no YAML")):
        with pytest.raises(
            ConfigError, match=f"{found}; expected the file of recordings, a YAML file that names calib"
        ):
            load_recordings(tmp_path / name)
