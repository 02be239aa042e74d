"""Write the page of a learned template: its matrix, a figure above each column, and the clips it was learned from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np
from markupsafe import Markup

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.templates.derived_templates import consistency
from kinedex.ops.templates.templates import Template, quantise
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, U64
from kinedex.pipelines.templates.stored_clips import clips_of
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.reports.matrix_pictures import row_names, set_rules, soft_colours
from kinedex.reports.motion_pages import FIGURES
from kinedex.reports.motion_pages.motion_page import Clip, Group, MotionPage, Place, write_motion_page
from kinedex.reports.template_text import template_heading
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

_ROW, _FIGURE, _NAMES, _NOTES, _FOOT = 14, 72, 168, 44, 22
_MIN_CELL_PX, _MAX_CELL_PX, _WIDTH = 14, 30, 1080  # pixels of a column, and of all columns if there is room
_APART = 24  # pixels between figures; where columns are narrower, every second figure is in a second row
_VIEW = 0.6  # radians by which figures are turned from the front


def write_template_page(store: Store, one: SubclassTemplate, delta: float, path: Path, most: int = FIGURES) -> str:
    """Write the page of a template, and return the sentence about how many of its clips it shows.

    Parameters
    ----------
    store : Store
        The store of the clips.
    one : SubclassTemplate
        The template.
    delta : float
        Entries within delta of 0 or 1 count as off or on; the others are wildcards.
    path : Path
        The file, ending in .html.
    most : int, optional
        Largest number of figures of clips.
    """
    clips = clips_of(store, one)
    words = [store.frames(take, start, stop).column("word").to_numpy() for take, start, stop in clips]
    template = one.learned.template
    paths, costs = _aligned(template, words, len(store.feature_set.features))
    order = np.argsort(costs, kind="stable").tolist()
    shown = tuple(
        Clip(
            take, start, stop, take, (f"{shown_seconds(stop - start, store.rate_hz)} s", f"distance {costs[place]:.3f}")
        )
        for place in order[:most]
        for take, start, stop in [clips[place]]
    )
    remarks = list(one.remarks)
    missing = len(one.clips) - len(clips)
    if missing:
        remarks.append(f"{missing} of its {len(one.clips)} clips are no motion of the store: mirrored, or gone since.")
    head = Markup("")
    if clips:
        medoids = _medoids(words, paths, len(template))
        figures = [_figure(store, clips[clip], frame) for clip, frame in medoids]
        head = Markup(_matrix(store, template, delta, figures))
    groups = [Group("Clips, the nearest to the template first", shown, len(clips))] if clips else []
    page = MotionPage(one.subclass, f"{template_heading(one, store.rate_hz)}.", "clip", groups, remarks, head)
    return write_motion_page(store, page, path)


def _aligned(template: Template, words: Sequence[U64], features: int) -> tuple[list[I64], list[float]]:
    """Return, for each clip, its frame at each column of the template, and its distance from the template."""
    shifts = np.arange(features, dtype=np.uint64)
    paths, costs = [], []
    for clip in words:
        bits = ((clip[:, None] >> shifts) & np.uint64(1)).astype(np.float64)
        distances = np.abs(template.values[:, None, :] - bits[None]).mean(axis=2)
        distances[:, clip == NO_WORD] = 1.0
        found = align(distances, np.ones(len(template)), np.ones(len(clip)))
        frames = np.zeros(len(template), np.int64)
        frames[found.path[:, 0]] = found.path[:, 1]
        paths.append(frames)
        costs.append(float(found.cost))
    return paths, costs


def _medoids(words: Sequence[U64], paths: Sequence[I64], columns: int) -> list[tuple[int, int]]:
    """Return, for each column, the clip and the frame whose word differs least from the words of the other clips."""
    found = []
    for column in range(columns):
        seen = np.array([clip[frames[column]] for clip, frames in zip(words, paths, strict=True)], np.uint64)
        differing = np.bitwise_count(seen[:, None] ^ seen[None, :]).sum(axis=1)
        clip = int(differing.argmin())
        found.append((clip, int(paths[clip][column])))
    return found


def _figure(store: Store, clip: Place, frame: int) -> F64:
    """Return the joints (J, 2) of a frame, seen obliquely from the front, in metres to the right and upwards."""
    take, start, _ = clip
    joints = list(store.feature_set.joints)
    points = joint_positions(store.frames(take, start + frame, start + frame + 1), tuple(joints))[:, :, 0]
    points = np.asarray(points, np.float64)
    turn = 0.0
    if {"lhip", "rhip"} <= set(joints):
        across = points[joints.index("lhip")] - points[joints.index("rhip")]
        turn = float(np.arctan2(across[2], across[0])) - _VIEW if np.isfinite(across).all() else 0.0
    x = points[:, 0] * np.cos(turn) + points[:, 2] * np.sin(turn)
    middle = np.nanmean(x) if np.isfinite(x).any() else 0.0
    return np.stack([x - middle, points[:, 1]], axis=1)


def _matrix(store: Store, template: Template, delta: float, figures: Sequence[F64]) -> str:
    """Return the matrix of a template as SVG, with a figure above each column."""
    features, columns = store.feature_set, len(template)
    rows, colours, agreement = row_names(features), soft_colours(template.values), consistency(template)
    values = quantise(template, delta).values(len(rows))
    cell = min(max(_WIDTH // columns, _MIN_CELL_PX), _MAX_CELL_PX)
    lines = 1 if cell >= _APART else 2
    width = _NAMES + columns * cell + _NOTES
    top = lines * _FIGURE + 8
    height = top + len(rows) * _ROW + _FOOT
    label = f"Matrix of the template: {len(rows)} features over {columns} columns, with a figure above each column"
    parts = [f'<svg width="{width}" height="{height}" viewBox="0 0 {width} {height}" role="img" aria-label="{label}">']
    for column, points in enumerate(figures):
        left, floor = _NAMES + (column + 0.5) * cell, _FIGURE * (1 + column % lines)
        parts += _stick_figure(points, tuple(store.feature_set.joints), left, floor)
    for row, name in enumerate(rows):
        y = top + row * _ROW
        parts.append(f'<text x="{_NAMES - 8}" y="{y + 11}" text-anchor="end">{escape(name)}</text>')
        share = f"{agreement[row]:.0%}"
        parts.append(f'<text class="soft" x="{_NAMES + columns * cell + 6}" y="{y + 11}">{share}</text>')
        for column in range(columns):
            red, green, blue = colours[row, column].tolist()
            value = values[column, row]
            state = "on" if value == 1 else "off" if value == 0 else "anything fits"
            title = f"{name}, {shown_seconds(column, store.rate_hz)} s: {template.values[column, row]:.2f}, {state}"
            parts.append(
                f'<rect x="{_NAMES + column * cell}" y="{y}" width="{cell}" height="{_ROW - 1}" '
                f'fill="rgb({red},{green},{blue})"><title>{escape(title)}</title></rect>'
            )
    for row in set_rules(features):
        y = top + row * _ROW - 1
        parts.append(f'<rect x="{_NAMES}" y="{y}" width="{columns * cell}" height="1" fill="currentColor"></rect>')
    every = max(1, round(0.25 * store.rate_hz))
    for column in range(0, columns, every):
        x, y = _NAMES + column * cell + 2, height - 6
        parts.append(f'<text class="soft" x="{x}" y="{y}">{shown_seconds(column, store.rate_hz)} s</text>')
    note = (
        "Above each column the frame of a clip that differs least from those of the others there; black is off in all "
        "clips, white is on in all, colours are between. At the end of a row: how much the clips agree."
    )
    return f'<section class="columns wide">{"".join(parts)}</svg></section><p class="caption">{note}</p>'


def _stick_figure(points: F64, joints: tuple[str, ...], centre: float, floor: float) -> Iterator[str]:
    """Yield the bones of a figure as SVG paths; left and right side have different colours."""
    scale = (_FIGURE - 6) / 1.95
    bones: dict[str, list[str]] = {"middle": [], "left": [], "right": []}
    for joint, parent in JOINT_PARENTS.items():
        if joint not in joints or parent not in joints:
            continue
        ends = points[[joints.index(joint), joints.index(parent)]]
        if np.isfinite(ends).all():
            (a, b), (c, d) = [(centre + x * scale, floor - y * scale) for x, y in ends]
            side = "middle" if joint == "root" else {"l": "left", "r": "right"}.get(joint[0], "middle")
            bones[side].append(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}")
    yield from (f'<path class="{side}" d="{"".join(lines)}"></path>' for side, lines in bones.items() if lines)
