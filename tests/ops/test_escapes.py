"""Text for terminals and JSON in which control characters are escaped."""

from __future__ import annotations

import json

from kinedex.ops.wording import json_escaped, visible


def test_every_control_character_of_json_is_escaped_and_its_values_stay() -> None:
    name = "".join(map(chr, range(0xA0))) + "\u202e"
    text = json_escaped(json.dumps(name, ensure_ascii=False))
    assert text.isascii()
    assert text.isprintable()
    assert json.loads(text) == name


def test_del_alone_is_escaped() -> None:
    assert json_escaped('"a\x7f"') == '"a\\u007f"'
    assert visible("a\x7f") == "a\\x7f"
