"""Configuration files: two readers of YAML that say the same, of which one is fast."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from kinedex.catalog import configs
from kinedex.catalog.configs import Located, parse_yaml, shipped_configs
from kinedex.ops.errors import ConfigError


@pytest.mark.parametrize("path", sorted(shipped_configs().rglob("*.yaml")), ids=lambda path: path.stem)
def test_a_file_reads_alike_with_and_without_the_fast_reader(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = path.read_text(encoding="utf-8")
    fast = configs._construct(configs._composed(text), (), one := Located(path, None, {}), yaml.SafeLoader(""))
    monkeypatch.setattr(configs, "_LOADERS", [yaml.SafeLoader])
    slow = configs._construct(configs._composed(text), (), other := Located(path, None, {}), yaml.SafeLoader(""))
    assert (fast, one.lines) == (slow, other.lines)


@pytest.mark.parametrize(
    "text", ["[" * 10_000, "&a [*a]", "a: *b", "\t- a", "x: [1, 2", "a: {b: c: d}", "é\udce9", "a: !!x 1"]
)
def test_what_is_no_yaml_is_refused_in_the_words_of_one_reader(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError) as fast:
        parse_yaml(text, "a.yaml")
    configs._parsed.cache_clear()
    monkeypatch.setattr(configs, "_LOADERS", [yaml.SafeLoader])
    with pytest.raises(ConfigError) as slow:
        parse_yaml(text, "a.yaml")
    assert str(fast.value) == str(slow.value)
