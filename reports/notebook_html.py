"""Make the HTML that notebooks show for stores, takes and queries; it needs no network."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from html import escape
from importlib import resources

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import Gap, KeyframeQuery, features_of
from kinedex.catalog.queries.query_writer import pose_groups
from kinedex.ops.arrays import F32
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.reports.embedded_motions import pack, parents_of

_STYLE = """:root { color-scheme: light dark; --line: #8884; --left: #1f6fc4; --right: #c8402f; }
body { margin: 0; font: 13px system-ui, sans-serif; color: #222; background: #fff; }
@media (prefers-color-scheme: dark) {
:root { --left: #6cb2ff; --right: #ff8a76; } body { color: #ddd; background: #1b1b1b; } }
.sides { float: right; } .left { color: var(--left); } .right { color: var(--right); }
canvas { display: block; width: 100%; max-width: 420px; cursor: ew-resize; touch-action: pan-y; }
.what { margin: .2rem 0; font-variant-numeric: tabular-nums; }
.controls { display: flex; gap: .6rem; align-items: center; max-width: 420px; }
input[type=range] { flex: 1; }
.close, .start { display: none; }"""

_CONTROLS = """<div id="player" hidden>
<canvas width="640" height="420" role="img" aria-label="Stick figure of the take; drag to turn it"></canvas>
<p class="what"><span class="sides"><b class="left">left</b> <b class="right">right</b></span>
<span class="now"></span> <span class="title"></span></p>
<div class="controls"><button type="button" class="play">play</button>
<input type="range" min="0" max="1" step="any" value="0" aria-label="Time within the take">
<label>speed <select><option value="0.25">¼</option><option value="0.5">½</option><option value="1" selected>1</option>
<option value="2">2</option></select></label>
<label><input type="checkbox" class="loop" checked> loop</label>
<button type="button" class="close">close</button></div></div>"""


@dataclass(frozen=True)
class ShownTake:
    """The data of a take that its HTML shows.

    `label` is the name of the take, and `facts` are pairs of a heading and a text. `joints` has the names of J joints,
    and `positions` (T, J, 3) their positions in metres in the frames that are played. `frames` is the number of frames
    of the take, and `rate_hz` the number of frames per second.
    """

    label: str
    facts: Sequence[tuple[str, str]]
    joints: tuple[str, ...]
    positions: F32
    frames: int
    rate_hz: float


def take_html(take: ShownTake) -> str:
    """Return the HTML of a take: its facts, and a player in an iframe, isolated from styles and scripts of the page."""
    page = escape(player_page(take), quote=True)
    player = (
        f'<iframe srcdoc="{page}" sandbox="allow-scripts" title="Player of {escape(take.label, quote=True)}" '
        'style="width: 440px; height: 350px; border: 0"></iframe>'
    )
    return f"<div><b>{escape(take.label)}</b>{_pairs(take.facts)}{player}</div>"


def player_page(take: ShownTake) -> str:
    """Return a complete HTML page that plays a take."""
    joints = [joint for joint in take.joints if joint in JOINT_PARENTS]
    columns = [take.joints.index(joint) for joint in joints]
    motion = pack(take.label, take.positions[:, columns].transpose(1, 2, 0), take.rate_hz)
    data = json.dumps({"joints": joints, "parents": parents_of(joints), "motions": [asdict(motion)]}).replace(
        "<", "\\u003c"
    )
    script = resources.files("kinedex.reports").joinpath("pages", "player.js").read_text("utf-8")
    shown = len(take.positions)
    what = "the take" if shown == take.frames else f"the first {shown_seconds(shown, take.rate_hz, 0)} seconds"
    start = (
        f'<svg class="start" data-take="{escape(take.label, quote=True)}">'
        f'<rect data-start="0" data-stop="{shown}" data-what="{what}"></rect></svg>'
    )
    return (
        f'<!doctype html><meta charset="utf-8"><style>{_STYLE}</style>{start}{_CONTROLS}'
        f'<script type="application/json" id="motions">{data}</script><script>{script}</script>'
        '<script>document.querySelector(".start rect").dispatchEvent(new Event("click", { bubbles: true }));</script>'
    )


def table_html(
    title: str,
    facts: Iterable[tuple[str, str]],
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    note: str = "",
) -> str:
    """Return facts and a table as HTML, with a note below the table if one is given."""
    below = f"<p>{escape(note)}</p>" if note else ""
    return f"<div><b>{escape(title)}</b>{_pairs(facts)}{_table(columns, rows)}{below}</div>"


def query_html(query: KeyframeQuery, feature_set: FeatureSet) -> str:
    """Return a query as HTML, with the time since the previous pose and the features of every pose."""
    rows: list[tuple[str, str, str, str]] = []
    for number, chain in enumerate(query.chains):
        for group in pose_groups(chain, feature_set):
            parts = [chain.keyframes[place] for place in group]
            named = [features_of(part, feature_set) for part in parts]
            on, off = ([name for both in named for name in both[side]] for side in (0, 1))
            gap = _gap(chain.gaps[group[0] - 1]) if group[0] else "or" if number else ""
            rows.append((gap, parts[0].name, ", ".join(on), ", ".join(off)))
    about = [("finds", query.target), *([("about", query.description)] if query.description else [])]
    return table_html(query.name, about, ["after", "pose", "on", "off"], rows)


def _gap(gap: Gap) -> str:
    if gap.high >= UNBOUNDED:
        return f"at least {gap.low} frames" if gap.low else "any time"
    return f"{gap.low} to {gap.high} frames"


def _pairs(rows: Iterable[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows)
    return f"<table>{''.join(cells)}</table>"


def _table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(f"<tr>{''.join(f'<td>{escape(_text(cell))}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _text(cell: object) -> str:
    return "" if cell is None else f"{cell:.2f}" if isinstance(cell, float | np.floating) else str(cell)
