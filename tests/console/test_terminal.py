"""The console of the command line."""

from __future__ import annotations

import pytest

from kinedex.console.terminal import make_console


def test_a_word_between_colons_is_no_picture(capsys: pytest.CaptureFixture[str]) -> None:
    make_console().print("take :walking: of 2", markup=False)
    assert capsys.readouterr().out == "take :walking: of 2\n"
