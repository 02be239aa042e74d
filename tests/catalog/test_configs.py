"""Configuration files: two readers of YAML with the same results, of which one is fast."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, Field

from kinedex.catalog import configs, yaml_nodes
from kinedex.catalog.configs import load_yaml, parse_yaml, shipped_configs
from kinedex.ops.errors import ConfigError


@pytest.mark.parametrize("path", sorted(shipped_configs().rglob("*.yaml")), ids=lambda path: path.stem)
def test_a_file_reads_alike_with_and_without_the_fast_reader(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = path.read_text(encoding="utf-8")
    fast = parse_yaml(text, path)
    configs._parsed.cache_clear()
    monkeypatch.setattr(yaml_nodes, "_LOADERS", yaml_nodes._LOADERS[-1:])
    slow = parse_yaml(text, path)
    assert (fast.data, fast.lines) == (slow.data, slow.lines)


@pytest.mark.parametrize(
    "text", ["[" * 10_000, "&a [*a]", "a: *b", "\t- a", "x: [1, 2", "a: {b: c: d}", "é\udce9", "a: !!x 1"]
)
def test_what_is_no_yaml_is_refused_in_the_words_of_one_reader(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError) as fast:
        parse_yaml(text, "a.yaml")
    configs._parsed.cache_clear()
    monkeypatch.setattr(yaml_nodes, "_LOADERS", yaml_nodes._LOADERS[-1:])
    with pytest.raises(ConfigError) as slow:
        parse_yaml(text, "a.yaml")
    assert str(fast.value) == str(slow.value)


SEXAGESIMAL = "1" + ":10" * 3000


def billion(levels: int) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]" for level in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("levels", [7, 9, 40, 2000])
def test_aliases_that_multiply_are_refused_before_they_are_expanded(levels: int) -> None:
    with pytest.raises(ConfigError, match=r"bomb.yaml: its aliases expand .* at most 100,000 are read"):
        parse_yaml(billion(levels), "bomb.yaml")


@pytest.mark.parametrize("number", ["1" * 5000, "-1" + "0" * 5000, "0x" + "f" * 5000, "0b" + "1" * 5000, SEXAGESIMAL])
@pytest.mark.parametrize("text", ["\na: [1, {}]", "\n? {}\n: 1", "\na: !!int '{}'"])
def test_an_integer_that_python_cannot_print_is_refused(number: str, text: str) -> None:
    with pytest.raises(ConfigError, match=r"yaml:2: has an integer of [\d,]+ characters, .{12}…; 400 are the most"):
        parse_yaml(text.replace("{}", number), "a.yaml")


def test_a_long_text_of_digits_is_written_in_quotes_and_read_again() -> None:
    assert parse_yaml(configs.scalar("1" * 5000), "a.yaml").data == "1" * 5000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 3_000_000, r"a\.yaml:1: is nested too deeply: a value lies 64 levels deep at most"),
        ("{a: " * 1_000_000, "nested too deeply"),
        ("- " * 2_500_000, "nested too deeply"),
        ("\n".join(" " * i + "a:" for i in range(100)), r"a\.yaml:64: is nested too deeply"),
        ("[" + ("[" * 60 + "]" * 60 + ",") * 5_100 + "]", r"has more than 300,000 keys and values; divide the file"),
        ("- 1\n" * 300_000, r"a\.yaml:300000: has more than 300,000 keys and values"),
        ("#" * 8_000_001, r"has 8\.0 MB, and 8 MB are the most"),
        ("- 1\n" * 100_000 + "]", "a.yaml:100001: is not valid YAML"),
    ],
)
def test_what_would_take_long_is_refused_at_its_bound(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_yaml(text, "a.yaml")


def test_a_file_at_the_bounds_is_read() -> None:
    assert len(parse_yaml("- 1\n" * 299_999, "a.yaml").data) == 299_999
    assert parse_yaml("[" * 63 + "1" + "]" * 63, "a.yaml").data
    assert parse_yaml("1" * 400, "a.yaml").data == int("1" * 400)


def test_a_file_that_never_ends_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ConfigError, match="is larger than may be, and 8 MB are the most"):
        load_yaml(path)


def test_merge_keys_that_multiply_are_refused_as_well() -> None:
    lines = ["a0: &a0 {x: 1, y: 2}"]
    lines += [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}], z{k}: 1}}" for k in range(1, 30)]
    with pytest.raises(ConfigError, match="its aliases expand"):
        parse_yaml("\n".join(lines), "bomb.yaml")


def test_a_long_file_without_aliases_is_read_and_so_are_a_few_aliases() -> None:
    long = "\n".join(f"k{i}: [{', '.join(['1'] * 50)}]" for i in range(2500))
    assert len(parse_yaml(long, "long.yaml").data) == 2500
    few = "a: &a [1, 2]\n" + "\n".join(f"k{i}: *a" for i in range(1000))
    assert parse_yaml(few, "few.yaml").data["k999"] == [1, 2]


class _Either(BaseModel):
    """A model with choices of types."""

    tau: Literal["auto"] | Annotated[float, Field(ge=0)] = 45.0
    names: Literal["all"] | list[str] = "all"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tau: often", r"x.yaml:1: tau: must be 'auto' or a valid number, got 'often'$"),
        ("tau: -3", r"x.yaml:1: tau: must be 'auto' or greater than or equal to 0, got -3$"),
        ("names: 7", r"x.yaml:1: names: must be 'all' or a valid list, got 7$"),
    ],
)
def test_an_error_of_a_choice_names_all_that_is_possible(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_yaml(tmp_path / "x.yaml").model(_Either)
