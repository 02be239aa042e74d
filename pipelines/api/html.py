"""HTML that notebooks show for stores, takes and queries; it needs no network."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from html import escape
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from kinedex.catalog.queries.queries import Gap, features_of
from kinedex.catalog.queries.query_writer import frames_shared
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.pipelines.report.motions import pack
from kinedex.storage.formats.motion.export import TREE

if TYPE_CHECKING:
    from kinedex.pipelines.api.query import Query
    from kinedex.pipelines.api.store import Store
    from kinedex.pipelines.api.take import Take

PLAYED_SECONDS = 120.0
"""The longest part of a take that a notebook carries: some 200 kB."""

SHOWN_TAKES = 10
"""The rows of the table of takes."""

_STYLE = """:root { color-scheme: light dark; --line: #8884; --accent: #d2691e; }
body { margin: 0; font: 13px system-ui, sans-serif; color: #222; background: #fff; }
@media (prefers-color-scheme: dark) { body { color: #ddd; background: #1b1b1b; } }
canvas { display: block; width: 100%; max-width: 420px; cursor: ew-resize; touch-action: pan-y; }
.what { margin: .2rem 0; font-variant-numeric: tabular-nums; }
.controls { display: flex; gap: .6rem; align-items: center; max-width: 420px; }
input[type=range] { flex: 1; }
.close, .start { display: none; }"""

_CONTROLS = """<div id="player" hidden>
<canvas width="640" height="420" role="img" aria-label="Stick figure of the take; drag to turn it"></canvas>
<p class="what"></p>
<div class="controls"><button type="button" class="play">play</button>
<input type="range" min="0" max="1" step="any" value="0" aria-label="Time within the take">
<label>speed <select><option value="0.25">¼</option><option value="0.5">½</option><option value="1" selected>1</option>
<option value="2">2</option></select></label>
<label><input type="checkbox" class="loop" checked> loop</label>
<button type="button" class="close">close</button></div></div>"""


def take_html(take: Take) -> str:
    """Return a take as HTML: its facts, its warnings, and a player in a frame of its own."""
    about = [
        ("frames", f"{len(take):,} at {take.rate_hz:g} Hz, {take.seconds:.2f} s"),
        ("invalid frames", f"{int((~take.valid).sum()):,}"),
        *((name, str(take.info[name])) for name in ("class", "actor", "source", "skeleton") if take.info.get(name)),
        *(("warning", warning) for warning in take.warnings),
    ]
    return f"<div><b>{escape(take.label)}</b>{_pairs(about)}{_frame(take)}</div>"


def _frame(take: Take) -> str:
    """Return the player as a frame that shares neither style nor script with the notebook."""
    page = escape(player_page(take), quote=True)
    return (
        f'<iframe srcdoc="{page}" sandbox="allow-scripts" title="Player of {escape(take.label, quote=True)}" '
        'style="width: 440px; height: 350px; border: 0"></iframe>'
    )


def player_page(take: Take) -> str:
    """Return a whole page that plays a take, at most the first `PLAYED_SECONDS`."""
    joints = [joint for joint in take.joints if joint in TREE]
    parents = [joints.index(parent) if (parent := TREE[joint]) in joints else -1 for joint in joints]
    shown = take[: round(PLAYED_SECONDS * take.rate_hz)]
    columns = [take.joints.index(joint) for joint in joints]
    motion = pack(take.label, shown.positions[:, columns].transpose(1, 2, 0), take.rate_hz)
    data = json.dumps({"joints": joints, "parents": parents, "motions": [asdict(motion)]}).replace("<", "\\u003c")
    script = resources.files("kinedex.pipelines.report").joinpath("pages", "player.js").read_text("utf-8")
    what = "the take" if len(shown) == len(take) else f"the first {PLAYED_SECONDS:g} of {take.seconds:.0f} s"
    start = (
        f'<svg class="start" data-take="{escape(take.label, quote=True)}">'
        f'<rect data-start="0" data-stop="{len(shown)}" data-what="{what}"></rect></svg>'
    )
    return (
        f'<!doctype html><meta charset="utf-8"><style>{_STYLE}</style>{start}{_CONTROLS}'
        f'<script type="application/json" id="motions">{data}</script><script>{script}</script>'
        '<script>document.querySelector(".start rect").dispatchEvent(new Event("click"));</script>'
    )


def store_html(store: Store) -> str:
    """Return a store as HTML: its size, its classes, and its first takes."""
    takes = store.takes()
    classes = takes["class"].drop_nulls().unique().sort().to_list()
    about = [
        ("path", str(store.path)),
        ("version", str(store.version)),
        ("takes", f"{len(store):,}, {float(takes['seconds'].sum() or 0) / 3600:.2f} hours at {store.rate_hz:g} Hz"),
        ("classes", ", ".join(classes[:20]) + (f" and {len(classes) - 20} more" if len(classes) > 20 else "")),
        ("features", f"{len(store.feature_set.features)} ({store.feature_set.name})"),
    ]
    columns = ["name", "class", "actor", "frames", "seconds"]
    rows = takes.select(columns).head(SHOWN_TAKES).rows()
    more = f"<p>and {takes.height - SHOWN_TAKES:,} more</p>" if takes.height > SHOWN_TAKES else ""
    return f"<div><b>kinedex store</b>{_pairs(about)}{_table(columns, rows)}{more}</div>"


def query_html(query: Query) -> str:
    """Return a query as HTML: of every pose the time since the one before, and its features."""
    rows: list[tuple[str, str, str, str]] = []
    for number, chain in enumerate(query.keyframe_query.chains):
        for group in frames_shared(chain, query.feature_set):
            parts = [chain.keyframes[place] for place in group]
            on, off = (
                [name for part in parts for name in features_of(part, query.feature_set)[side]] for side in (0, 1)
            )
            gap = _gap(chain.gaps[group[0] - 1]) if group[0] else "or" if number else ""
            rows.append((gap, parts[0].name, ", ".join(on), ", ".join(off)))
    about = [("finds", query.target), *([("about", text)] if (text := query.keyframe_query.description) else [])]
    table = _table(["after", "pose", "on", "off"], rows)
    return f"<div><b>{escape(query.name)}</b>{_pairs(about)}{table}</div>"


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
