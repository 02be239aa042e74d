"""Name the classes of mirrored motions, by the words for left and right in the names of classes."""

from __future__ import annotations

import re
from collections.abc import Collection

_SIDES = {"left": "right", "right": "left", "l": "r", "r": "l"}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def mirrored_class(name: str, known: Collection[str] = ()) -> str:
    """Return the class of a mirrored motion: left and right, and L and R, are exchanged in its name.

    Words end at capital letters and at all characters other than letters: "kickLFront1Reps" becomes "kickRFront1Reps",
    and "wave-left-hand" becomes "wave-right-hand". A lower-case l or r counts if it stands alone. A word that begins
    with L or R, as in "startLelbow", is exchanged only if "startRelbow" is an existing class.

    Parameters
    ----------
    name : str
        The class.
    known : collection of str
        The existing classes.
    """

    def exchanged(match: re.Match[str]) -> str:
        word, text = match[0], match.string
        other = _SIDES.get(word.lower())
        alone = not text[: match.start()][-1:].isalnum() and not text[match.end() :][:1].isalnum()
        if other is None or (word in ("l", "r") and not alone):
            return word
        return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other

    # L or R before a capitalised word counts as a separate word, as in LFront
    image = _WORD.sub(exchanged, re.sub(r"(?<![A-Z])([LR])(?=[A-Z][a-z])", "\\1\0", name)).replace("\0", "")
    if image == name:
        other = re.sub(r"(?<![A-Z])[LR](?=[a-z])", lambda match: _SIDES[match[0].lower()].upper(), name)
        return other if other in known else name
    return image
