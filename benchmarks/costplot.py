"""Plot cost over size on log-log axes as SVG (thesis, Figure 3.10)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]
_WIDTH, _HEIGHT, _EDGE = 640, 420, 60


def write_plot(file: Path, sizes: F64, times: F64, title: str) -> None:
    """Draw one dot per query, milliseconds over the word runs of its lists, and a line of slope 1."""
    shown = sizes > 0
    x, y = np.log10(sizes[shown]), np.log10(times[shown] * 1e3)
    left, right = float(np.floor(x.min())), float(np.ceil(x.max()))
    low, high = float(np.floor(y.min())), float(np.ceil(y.max()))

    def across(value: float) -> float:
        return _EDGE + (value - left) / max(right - left, 1) * (_WIDTH - 2 * _EDGE)

    def up(value: float) -> float:
        return _HEIGHT - _EDGE - (value - low) / max(high - low, 1) * (_HEIGHT - 2 * _EDGE)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}"',
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        f'<text x="{_WIDTH / 2}" y="24" text-anchor="middle">{title}</text>',
        f'<text x="{_WIDTH / 2}" y="{_HEIGHT - 12}" text-anchor="middle">word runs of all lists</text>',
        f'<text x="16" y="{_HEIGHT / 2}" text-anchor="middle" transform="rotate(-90 16 {_HEIGHT / 2})">ms</text>',
    ]
    for power in range(int(left), int(right) + 1):
        parts.append(f'<path d="M{across(power):.1f} {up(low):.1f}V{up(high):.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{across(power):.1f}" y="{up(low) + 18:.1f}" text-anchor="middle">1e{power}</text>')
    for power in range(int(low), int(high) + 1):
        parts.append(f'<path d="M{across(left):.1f} {up(power):.1f}H{across(right):.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{across(left) - 6:.1f}" y="{up(power) + 4:.1f}" text-anchor="end">1e{power}</text>')
    offset = float(np.median(y - x))
    begin, end = max(left, low - offset), min(right, high - offset)
    line = f"M{across(begin):.1f} {up(begin + offset):.1f}L{across(end):.1f} {up(end + offset):.1f}"
    parts.append(f'<path d="{line}" stroke="#999"/>')
    parts += [
        f'<circle cx="{across(a):.1f}" cy="{up(b):.1f}" r="3" fill="#1565c0"/>' for a, b in zip(x, y, strict=True)
    ]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join([*parts, "</svg>"]) + "\n", encoding="utf-8")
