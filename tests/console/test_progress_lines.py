"""Long steps report themselves where the output is no terminal: by a line now and then, and more and more seldom."""

from __future__ import annotations

import io
import logging
import threading

import pytest
from rich.console import Console

from kinedex.console import terminal as pulse
from kinedex.console.terminal import Terminal
from kinedex.ops.wording import duration


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pulse, "FIRST_SECONDS", 0.02)


class Shown(io.StringIO):
    """An output that reports when something was written to it."""

    def __init__(self) -> None:
        super().__init__()
        self.written = threading.Event()

    def write(self, text: str) -> int:
        self.written.set()
        return super().write(text)


def test_a_long_step_reports_itself_in_the_output_and_the_log(fast: None, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "kinedex.progress")
    shown = Shown()
    terminal = Terminal(Console(file=shown, width=200))
    with terminal.activity("index"):
        assert shown.written.wait(60)
        with terminal.progress("reading takes", 2_000) as bar:
            bar.advance(1_200)
            shown.written.clear()
            assert shown.written.wait(60)
    lines = shown.getvalue().splitlines()
    assert lines[0].startswith("    index: ")
    assert any(line.startswith("    reading takes: 1,200 of 2,000, ") for line in lines)
    assert caplog.messages[0] == lines[0].strip()


def test_nothing_is_printed_when_quiet_or_on_a_terminal(fast: None, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "kinedex.progress")
    for options in ({"quiet": True}, {"force_terminal": True}):
        shown = io.StringIO()
        heard = threading.Event()
        handler = logging.Handler()
        handler.emit = lambda record, heard=heard: heard.set()  # type: ignore[method-assign,misc]
        logging.getLogger("kinedex.progress").addHandler(handler)
        try:
            with Terminal(Console(file=shown, **options)).activity("index"):  # type: ignore[arg-type]
                assert heard.wait(60), "the log has it"
        finally:
            logging.getLogger("kinedex.progress").removeHandler(handler)
        assert shown.getvalue() == ""


def test_a_message_puts_the_next_line_off_and_a_long_step_has_few() -> None:
    beat = pulse.ProgressLines(lambda text: None)
    beat.speak()
    now = beat._spoken
    assert beat._due(now) == pytest.approx(pulse.FIRST_SECONDS, abs=1)
    assert beat._due(now - 3600) == pytest.approx(pulse.SHARE * 3600, abs=1)


def test_a_counted_step_reports_the_time_that_is_left() -> None:
    step = pulse.ProgressStep("reading takes", 400)
    step.begun -= 100
    assert step.seconds_left(step.begun + 100) is None
    assert step.text(120) == "reading takes: 0 of 400, 120 s so far"
    step.done = 100
    assert step.seconds_left(step.begun + 100) == pytest.approx(300)
    assert step.text(120) == "reading takes: 100 of 400, 120 s so far, about 5 min left"
    step.done = 400
    assert step.text(120) == "reading takes: 400 of 400, 120 s so far"
    assert pulse.ProgressStep("index").text(120) == "index: 120 s so far"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "1 s"), (59, "59 s"), (60, "1 min"), (200, "3 min 20 s"), (1234, "20 min"), (7500, "2 h 5 min")],
)
def test_durations_have_two_units_at_most(seconds: float, text: str) -> None:
    assert duration(seconds) == text
