"""Define the colours of classes; up to twenty classes differ clearly, on light and on dark backgrounds."""

from __future__ import annotations

# Each pair has one colour for white and one for nearly black backgrounds, with a contrast of at least 3:1. Any two
# colours for one background are at least 0.1 apart in OKLab, five times the smallest visible difference. With more
# classes than pairs, colours repeat; rows have names, so that a class is never marked by its colour alone.
CLASS_COLOURS: tuple[tuple[str, str], ...] = (
    ("#4e66c5", "#5097ff"),
    ("#b18e15", "#decd48"),
    ("#7e032c", "#ca545d"),
    ("#0b5d2a", "#2d8949"),
    ("#c67597", "#ff99c3"),
    ("#5e96d4", "#78c7fd"),
    ("#d75a21", "#fd7562"),
    ("#593b11", "#a47726"),
    ("#09495f", "#627981"),
    ("#833ea7", "#a66cdc"),
    ("#06288e", "#2076c9"),
    ("#28842d", "#2eb370"),
    ("#876b01", "#b5a737"),
    ("#80647d", "#b59ab7"),
    ("#187b90", "#4da6bc"),
    ("#9d6bcd", "#d58efe"),
    ("#a72a6a", "#e166ab"),
    ("#718f76", "#94cf9f"),
    ("#a63d02", "#ecae86"),
    ("#653b69", "#985b93"),
)


def colour_slot(index: int) -> int:
    """Return the number of the pair of colours for the class at an index."""
    return index % len(CLASS_COLOURS)


def colour_rules(slots: int) -> tuple[str, str]:
    """Return the CSS rules of the variable --k in the classes k0, k1, …, for light and for dark pages."""
    used = CLASS_COLOURS[: min(slots, len(CLASS_COLOURS))]
    light = "".join(f".k{i}{{--k:{pair[0]}}}" for i, pair in enumerate(used))
    dark = "".join(f".k{i}{{--k:{pair[1]}}}" for i, pair in enumerate(used))
    return light, dark
