"""Words of the command line have the values that Typer gives them, with or without its validators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from hypothesis import example, given
from hypothesis import strategies as st

from kinedex.console.plain_values import convert_plain_values, is_plain


def _parameters() -> list[Any]:
    """Return parameters of all kinds that commands have, as Typer makes them."""
    app = typer.Typer()

    @app.command()
    def command(  # the parameters alone count
        text: str,
        several: list[str],
        path: Path | None = None,
        paths: Annotated[list[Path] | None, typer.Option()] = None,
        count: int = 3,
        bounded: Annotated[int | None, typer.Option(min=0, max=50)] = None,
        share: Annotated[float, typer.Option(min=0, max=0.4999)] = 0.1,
        parsed: Annotated[float | None, typer.Option(parser=float)] = None,
        there: Annotated[Path | None, typer.Option(exists=True)] = None,
        folder: Annotated[Path | None, typer.Option(file_okay=False)] = None,
    ) -> None: ...

    return [one for one in typer.main.get_command(app).params if "completion" not in one.name]


PARAMETERS, CHANGED = _parameters(), _parameters()
convert_plain_values(CHANGED)

WORDS = (
    st.text(max_size=4)
    | st.integers(-100, 10**12).map(str)
    | st.floats(0, 1).map(str)
    | st.sampled_from(["007", "1_0", " 5", "5.0", "1e3", ".5", "5.", "٣", "inf", "/", __file__, "\udcff", "a\0b", ""])
)


def value_of(parameter: Any, words: Any) -> Any:
    try:
        return parameter.get_runtime_param().coerce(words, param=parameter, ctx=None)
    except (typer.BadParameter, ValueError) as fault:
        return type(fault), str(fault)


@given(words=st.lists(WORDS, min_size=1, max_size=2))
@example(words=["7", "x"])
def test_a_value_is_that_of_typer(words: list[str]) -> None:
    for one, changed in zip(PARAMETERS, CHANGED, strict=True):
        word: Any = tuple(words) if one.multiple or one.nargs == -1 else words[0]
        assert repr(value_of(changed, word)) == repr(value_of(one, word)), one.name


def test_nothing_given_is_none_and_a_default_stays() -> None:
    for one, changed in zip(PARAMETERS, CHANGED, strict=True):
        for value in (None, one.default):
            assert repr(value_of(changed, value)) == repr(value_of(one, value))


@pytest.mark.parametrize(("name", "word"), [("text", "x"), ("path", "no/such"), ("count", "12"), ("share", "0.25")])
def test_ordinary_words_are_plain(name: str, word: str) -> None:
    (one,) = [one for one in PARAMETERS if one.name == name]
    assert is_plain(word, one.type_descriptor.annotation, one.type_descriptor.parameter_info)
