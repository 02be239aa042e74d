"""Make file names of takes that are valid on every operating system and all different."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Sequence

_RESERVED = re.compile(r"(?:con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(?:\..*)?", re.IGNORECASE)
_FORBIDDEN = frozenset('/\\:*?"<>|')
_INVISIBLE = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
_MOST_BYTES = 180


def file_names(takes: Sequence[str]) -> list[str]:
    """Return a file name without its extension for each take: the take's name if it is valid on every system.

    Characters that are invisible or forbidden on some system become underscores. A name that was changed, and one that
    another take already has on a system that ignores case, ends in a tilde and eight digits of its checksum.
    """
    used: set[str] = set()
    names = []
    for take in takes:
        name = _safe(take)
        if name != take or _key(name) in used:
            name = f"{name}~{hashlib.sha256(take.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"
        used.add(_key(name))
        names.append(name)
    return names


def _safe(take: str) -> str:
    name = "".join("_" if one in _FORBIDDEN or unicodedata.category(one) in _INVISIBLE else one for one in take)
    name = name.encode()[:_MOST_BYTES].decode(errors="ignore").strip(" ").rstrip(". ")
    return f"{name}_" if not name or _RESERVED.fullmatch(name) else name


def _key(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
