"""Mutations: a small valid file becomes one that a broken program, disk or network might have left."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

Mutation = Callable[[bytes, Random], bytes]

NUMBERS = (
    *(b"nan", b"NaN", b"-nan", b"inf", b"-Inf", b"infinity", b"1e308", b"-1.7976931348623157e308", b"1e400", b"1e-400"),
    *(b"1e5000", b"4.9e-324", b"0", b"-0.0", b"-1", b"1", b"2", b"7", b"255", b"65536", b"2147483648", b"4294967296"),
    *(b"9223372036854775807", b"9223372036854775808", b"99999999999999999999", b"1e18", b"1e-18", b"1e9", b"1e6"),
    *(b"100000", b"1000000000", b"0x10", b"1_000", b"1,5", b".", b"-", b"+", b"e5", b"1e", b"1e+", b"1.2.3", b"--1"),
    *(b"+-1", b"1d5", b"\xd9\xa3", b"\xef\xbc\x91", b"1" * 400, b"0." + b"0" * 400 + b"1", b"9" * 18, b"9" * 19),
    *(b"120", b"30", b"0.0333333", b"0.00001", b"10001", b"true", b"null", b"#NV", b"1.#QNAN", b"1.#INF", b""),
)
"""Replacements of numbers: none, huge, tiny, of other notations."""

_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z0-9_:.-]*")
_LINE_END = re.compile(rb"\r\n|\r|\n")
_LINE_ENDS = (b"\n", b"\r\n", b"\r", b"\n\r", b"\n\n", b"\x0b", b"\x0c", b"\x85", b"\xe2\x80\xa8", b" ")
_SPACES = (b"\t", b"  ", b" \t ", b",", b";", b"\xa0", b"\x0b", b"\x0c", b"\x00", b"", b"\xe2\x80\x83")
_SIZES = (1, 1, 2, 3, 8, 30, 200)


def _span(data: bytes, random: Random) -> tuple[int, int]:
    start = random.randrange(len(data) + 1)
    return start, min(len(data), start + random.choice(_SIZES))


def _swap(data: bytes, pattern: re.Pattern[bytes], choices: Sequence[bytes], random: Random) -> bytes:
    """Replace one match of a pattern with one of some texts."""
    found = list(pattern.finditer(data, *_window(data, random)))
    if not found:
        return data
    match = random.choice(found)
    return data[: match.start()] + random.choice(choices) + data[match.end() :]


def _window(data: bytes, random: Random) -> tuple[int, int]:
    """Choose an interval of the data: the beginning, where headers are, as often as all the rest."""
    start = 0 if random.random() < 0.5 else random.randrange(len(data) + 1)
    return start, start + 2000


def flip_bytes(data: bytes, random: Random) -> bytes:
    """Change a few bytes."""
    changed = bytearray(data)
    for _ in range(random.choice(_SIZES[:5])):
        if changed:
            changed[random.randrange(len(changed))] = random.randrange(256)
    return bytes(changed)


def flip_bits_of_beginning(data: bytes, random: Random) -> bytes:
    """Flip one bit of the first bytes, where headers are."""
    changed = bytearray(data)
    if changed:
        changed[random.randrange(min(len(changed), 200))] ^= 1 << random.randrange(8)
    return bytes(changed)


def insert_bytes(data: bytes, random: Random) -> bytes:
    """Random bytes between others."""
    at = random.randrange(len(data) + 1)
    return data[:at] + random.randbytes(random.choice(_SIZES)) + data[at:]


def remove_bytes(data: bytes, random: Random) -> bytes:
    """Remove an interval."""
    start, stop = _span(data, random)
    return data[:start] + data[stop:]


def repeat_bytes(data: bytes, random: Random) -> bytes:
    """Repeat an interval several times."""
    start, stop = _span(data, random)
    return data[:stop] + data[start:stop] * random.choice((1, 2, 50, 2000)) + data[stop:]


def truncate(data: bytes, random: Random) -> bytes:
    """Cut the file off."""
    return data[: random.randrange(len(data) + 1)]


def truncate_a_little(data: bytes, random: Random) -> bytes:
    """Remove the file's last bytes."""
    return data[: -random.randint(1, 60)]


def garbage_at_the_end(data: bytes, random: Random) -> bytes:
    """Something follows the file, as from a disk's last block."""
    return data + random.choice((b"\0" * 512, random.randbytes(100), data[:200], b"\x1a", b"}", b"\n" * 5000))


def swap_line_ends(data: bytes, random: Random) -> bytes:
    """Other line ends, all or some."""
    new, share = random.choice(_LINE_ENDS), random.choice((1.0, 0.5, 0.02))
    return _LINE_END.sub(lambda found: new if random.random() < share else found[0], data)


def swap_spaces(data: bytes, random: Random) -> bytes:
    """Other spaces between words, all or some."""
    new, share = random.choice(_SPACES), random.choice((1.0, 0.02, 0.002))
    return re.sub(rb"[ \t,]", lambda found: new if random.random() < share else found[0], data)


def change_lines(data: bytes, random: Random) -> bytes:
    """Remove, double or move a line."""
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return data
    at, other = (random.randrange(min(len(lines), random.choice((20, 10**9)))) for _ in range(2))
    match random.randrange(5):
        case 0:
            del lines[at : at + random.choice(_SIZES)]
        case 1:
            lines[at:at] = lines[at : at + random.choice(_SIZES)] * random.choice((1, 2, 40))
        case 2:
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            lines[at] = lines[at].rstrip(b"\r\n")
        case _:
            lines[at] = b""
            lines[other] += random.choice(lines)
    return b"".join(lines)


def change_number(data: bytes, random: Random) -> bytes:
    """Replace a number with text that is not one, or with a huge one."""
    return _swap(data, _NUMBER, NUMBERS, random)


def change_all_numbers(data: bytes, random: Random) -> bytes:
    """Replace many numbers with another one."""
    new, share = random.choice(NUMBERS), random.choice((1.0, 0.1, 0.01))
    return _NUMBER.sub(lambda found: new if random.random() < share else found[0], data)


def scale_number(data: bytes, random: Random) -> bytes:
    """Give a number more digits or another exponent."""
    found = list(_NUMBER.finditer(data, *_window(data, random)))
    if not found:
        return data
    match = random.choice(found)
    return (
        data[: match.end()] + random.choice((b"0", b"000", b"e300", b"e-300", b"e", b".5", b"9")) + data[match.end() :]
    )


def change_word(data: bytes, random: Random) -> bytes:
    """Replace a word with another word of the file, or change its case."""
    found = list(_WORD.finditer(data, *_window(data, random)))
    if not found:
        return data
    match = random.choice(found)
    word = match[0]
    new = random.choice((random.choice(found)[0], word.upper(), word.swapcase(), word[:-1], word * 2, word * 3000, b""))
    return data[: match.start()] + new + data[match.end() :]


def other_encoding(data: bytes, random: Random) -> bytes:
    """Encode the text in an unexpected encoding, or insert letters that the encoding lacks."""
    text = data.decode("latin-1")
    match random.randrange(7):
        case 0:
            return text.encode("utf-16")
        case 1:
            return text.encode("utf-16-be")
        case 2:
            return b"\xef\xbb\xbf" + data
        case 3:
            return text.encode("utf-32")
        case 4:
            return data.upper()
        case 5:
            return re.sub(rb"[aeiou]", lambda found: random.choice((found[0], b"\xe9", b"\xc3\xa9", b"\xff")), data)
        case _:
            at = random.randrange(len(data) + 1)
            return data[:at] + random.choice((b"\0", b"\x1b[2J", b"\xed\xa0\x80", b"\xf0\x9f\x95\xba")) + data[at:]


def long_line(data: bytes, random: Random) -> bytes:
    """Insert a line, a word or a number of very many bytes somewhere."""
    at = random.randrange(len(data) + 1)
    what = random.choice((b"x", b"9", b" ", b"1 ", b"\n", b"\t", b"0.5,", b"#", b"-", b'"', b",", b"a_x,", b"\r"))
    return data[:at] + what * random.choice((10_000, 200_000)) + data[at:]


def join(data: bytes, random: Random) -> bytes:
    """Insert an interval of the file a second time, anywhere."""
    start, stop = sorted(random.randrange(len(data) + 1) for _ in range(2))
    at = random.randrange(len(data) + 1)
    return data[:at] + data[start:stop] + data[at:]


ANY: tuple[Mutation, ...] = (
    *(flip_bytes, flip_bits_of_beginning, insert_bytes, remove_bytes, repeat_bytes),
    *(truncate, truncate_a_little, garbage_at_the_end, join),
)
"""Mutations of bytes, whatever they mean."""

TEXT: tuple[Mutation, ...] = (
    *(swap_line_ends, swap_spaces, change_lines, change_lines, change_number, change_number, change_number),
    *(change_all_numbers, scale_number, change_word, change_word, other_encoding, long_line),
)
"""Mutations of text."""


def insert_word(data: bytes, random: Random, words: Sequence[bytes]) -> bytes:
    """Insert a word of the format, mostly at the beginning of a line."""
    places = [found.end() for found in _LINE_END.finditer(data, *_window(data, random))]
    at = random.choice(places) if places and random.random() < 0.8 else random.randrange(len(data) + 1)
    return data[:at] + random.choice(words) + random.choice((b"", b" ", b"\n")) + data[at:]


def nest(data: bytes, random: Random, pairs: Sequence[tuple[bytes, bytes]]) -> bytes:
    """Insert very deep nesting, closed again or not; `pairs` open and close it."""
    opening, closing = random.choice(pairs)
    depth = random.choice((3, 100, 990, 1100, 12_000))
    at = random.choice([found.end() for found in _LINE_END.finditer(data, *_window(data, random))] or [0])
    return data[:at] + opening * depth + closing * random.choice((depth, depth, 0, depth - 1)) + data[at:]


def mutate(data: bytes, mutations: Sequence[Mutation], random: Random, largest: int) -> bytes:
    """Apply one to four mutations in turn; fewer are likelier. The result has at most `largest` bytes."""
    for _ in range(random.choice((1, 1, 1, 2, 2, 3, 4))):
        data = random.choice(mutations)(data, random)[:largest]
    return data
