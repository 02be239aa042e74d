"""Parse YAML into nodes within bounds on bytes, nodes, depth, digits, and the expansion of aliases.

All YAML that kinedex reads is parsed here, so that no malicious file takes more than seconds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from kinedex.ops.errors import ConfigError

MAX_BYTES = 8_000_000
"""Maximum number of bytes of a YAML text."""

MAX_NODES = 300_000
"""Maximum number of keys, values, lists and mappings of a file; the templates of 65 classes have 260,000."""

MAX_DEPTH = 64
"""Maximum number of levels of lists and mappings; the deepest file that ships with kinedex has 9."""

MAX_DIGITS = 400
"""Maximum number of characters of an integer; Python prints none of more than 4,300 decimal digits."""

MAX_VALUES = 100_000
"""Maximum number of values after the expansion of aliases; a file without aliases may have `MAX_NODES`."""

EXPLAINED_CHARACTERS = 200_000
"""Maximum length of an invalid text that is parsed again in pure Python for a better message; this takes a second."""

_INTEGER = "tag:yaml.org,2002:int"


class _Bounded(Composer):
    """Composes nodes, and raises a ConfigError at the first node that exceeds the bounds."""

    path: Path
    peek_event: Any  # a method of the parser
    _nodes = _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return the next node with its children."""
        self._nodes += 1
        self._depth += 1
        line = self.peek_event().start_mark.line + 1
        if self._nodes > MAX_NODES:
            raise ConfigError(
                self.path, f"has more than {MAX_NODES:,} keys and values; divide the file, or use CSV", line=line
            )
        if self._depth > MAX_DEPTH:
            raise ConfigError(
                self.path, f"is nested too deeply: a value lies {MAX_DEPTH} levels deep at most", line=line
            )
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(node, yaml.ScalarNode) and node.tag == _INTEGER and len(node.value) > MAX_DIGITS:
            raise ConfigError(
                self.path,
                f"has an integer of {len(node.value):,} characters, {node.value[:12]}…; {MAX_DIGITS} are the most; "
                "a text stands in quotes",
                line=line,
            )
        return node


class _PlainLoader(_Bounded, yaml.SafeLoader):
    """PyYAML's loader in pure Python, whose error messages are better than those of libyaml."""


_LOADERS: list[Any] = [_PlainLoader]

if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    class _FastLoader(_Bounded, CParser, SafeConstructor, Resolver):
        """A loader of libyaml events that builds nodes in Python, where deep nesting raises instead of crashing."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            Composer.__init__(self)
            SafeConstructor.__init__(self)
            Resolver.__init__(self)

    _LOADERS.insert(0, _FastLoader)


def composed(text: str, path: Path) -> yaml.Node | None:
    """Return the node tree of a text, using libyaml if it is installed, since it is seven times as fast.

    Parameters
    ----------
    text : str
        The YAML.
    path : Path
        The file that messages name.

    Raises
    ------
    ConfigError
        The text exceeds the bounds.
    yaml.YAMLError, ValueError
        The text is not valid YAML.
    """
    if len(text) > MAX_BYTES:
        raise too_large(path, f"has {len(text) / 1e6:.1f} MB")
    root = None
    for number, kind in enumerate(_LOADERS):
        try:
            root = _document(kind, text, path)
            break
        except (yaml.YAMLError, ValueError):
            # The parser in Python gives better messages than libyaml for invalid YAML.
            if number == len(_LOADERS) - 1 or len(text) > EXPLAINED_CHARACTERS:
                raise
    if root is not None:
        _refuse_bombs(root, path)
    return root


def too_large(path: Path, found: str) -> ConfigError:
    """Return the error for a file of too many bytes."""
    return ConfigError(path, f"{found}, and {MAX_BYTES / 1e6:g} MB are the most; divide the file, or use CSV")


def _document(kind: Any, text: str, path: Path) -> yaml.Node | None:
    loader = kind(text)
    loader.path = path
    try:
        root: yaml.Node | None = loader.get_single_node()
        return root
    finally:
        loader.dispose()


def _refuse_bombs(root: yaml.Node, path: Path) -> None:
    """Raise an error if a file's aliases would expand to too many values; the values are counted without expansion."""
    sizes: dict[int, int] = {}
    waiting: list[tuple[yaml.Node, bool]] = [(root, False)]
    while waiting:
        node, ready = waiting.pop()
        parts = _parts(node)
        if ready:
            # An alias within the node that it refers to has no size yet; the construction rejects it later.
            sizes[id(node)] = 1 + sum(sizes.get(id(part), 0) for part in parts)
        elif id(node) not in sizes:
            sizes[id(node)] = 0
            waiting.append((node, True))
            waiting.extend((part, False) for part in parts)
    if sizes[id(root)] > max(MAX_VALUES, len(sizes)):
        raise ConfigError(
            path,
            f"its aliases expand {len(sizes):,} values to {sizes[id(root)]:,}, and at most {MAX_VALUES:,} are read; "
            "write the values out, or use fewer aliases of aliases",
        )


def _parts(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []
