"""Distance curves over a take, the warping paths of hits, and DTW alignments of two intervals, for the page.

`GET /api/takes/ID/templates` answers with `templates_of_take`; `GET /api/takes/ID/curve` with one little-endian float32
per analysis frame: the cost of the best match that ends there, ∞ where there is none; `GET /api/takes/ID/hit` with
`nearest_hit`; `GET /api/align` with `aligned_intervals`; `GET /api/template` with `template_image`. A template is
named by its subclass, kind and stage.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from starlette.requests import Request

from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import get, get_of_take, take_of
from kinedex.explorer.motion import check_frame, check_interval, frames_of, name_of, whole_number
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.take_lanes import words_of_take
from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.distances.curve_path import curve_paths
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.intervals import Interval
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.nearest_clip import nearest_clips, word_differences
from kinedex.ops.templates.templates import Kind, QuantisedTemplate, quantise
from kinedex.ops.templates.warping import align
from kinedex.ops.words import ALL_KNOWN, U64
from kinedex.pipelines.annotation.parameters import DEFAULT_TAU
from kinedex.pipelines.templates.stored_clips import clips_of
from kinedex.pipelines.templates.stored_templates import choose_template, stored_templates
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.storage.store.store import Store

Row = dict[str, Any]

DELTA = 0.05
"""The default δ: values of a template within δ of 0 or 1 count, the others are wildcards."""

MAX_ALIGNED = 1800
"""Maximum number of frames of each of two aligned intervals: a minute, for which the matrix of costs takes 26 MB."""


@dataclass(frozen=True)
class TemplateChoice:
    """A learned template: its subclass, its kind, and the stage that learned it (None for the stage shown by default).

    `delta` is as for `ops.templates.templates.quantise`.
    """

    name: str
    kind: Kind = "soft"
    stage: str | None = None
    delta: float = DELTA


def templates_of_take(store: Store, take_id: int) -> Row:
    """Return the templates whose curves a take can show, and the thresholds that annotation used.

    Parameters
    ----------
    store : Store
        The store of the take.
    take_id : int
        The take.

    Returns
    -------
    dict
        `templates`: `name`, `kind`, `stage`, `columns`, `clips`, and `applied`, false where the body of the take lacks
        too many joints. `tau`, `tau_by_class`, `delta`: those of the annotation, or the defaults. `found`: the
        subclasses of the annotations of the take, the most frequent first.

    Raises
    ------
    KinedexError
        No take has this id.
    """
    frames_of(store, take_id)
    parts = store.manifest.results.get("annotated_takes") or ()
    record = store.manifest.stages.get(parts[-1].stage) if parts else None
    params = dict(record.summary) if record else {}
    delta = float(params.get("delta", DELTA))
    known = store.known.get(take_id, int(ALL_KNOWN))
    rows = []
    for each in stored_templates(store) if store.manifest.results.get("templates") else ():
        template = each.one.learned.template
        rows.append(
            {
                "name": each.one.subclass,
                "kind": each.one.kind,
                "stage": each.stage,
                "columns": len(template),
                "clips": len(each.one.clips),
                "applied": restricted_template(quantise(template, delta), known) is not None,
            }
        )
    found: list[str] = []
    if store.manifest.results.get("annotations"):
        asked = (
            "SELECT subclass FROM annotations WHERE take_id = ? AND subclass IS NOT NULL "
            "GROUP BY subclass ORDER BY count(*) DESC, subclass"
        )
        found = [row["subclass"] for row in store.sql(asked, [take_id]).to_pylist()]
    tau = params.get("tau")
    return {
        "templates": rows,
        "tau": tau if isinstance(tau, int | float) else DEFAULT_TAU,
        "tau_by_class": params.get("tau_by_class") or {},
        "delta": delta,
        "found": found,
        "command": command_line("kinedex", "template", "list", store.path),
        "python": python_lines(store.path, "store.templates()"),
    }


def template_image(store: Store, choice: TemplateChoice) -> Row:
    """Return the values of a template, feature by feature, with the weights of features and the names of its clips.

    Parameters
    ----------
    store : Store
        The store to read.
    choice : TemplateChoice
        The template.

    Returns
    -------
    dict
        `name`, `kind`, `columns`; `values`, for each feature its value in each column from 0 to 1 in steps of 0.01;
        `weights` of features, null where all count alike; `clips`, the names of the clips.

    Raises
    ------
    KinedexError
        There is no such template.
    """
    learned = choose_template(store, choice.name, choice.kind, choice.stage)
    template = learned.learned.template
    weights = template.feature_weights
    return {
        "name": choice.name,
        "kind": choice.kind,
        "columns": len(template),
        "values": np.round(template.values.T, 2).tolist(),
        "weights": None if weights is None else weights.tolist(),
        "clips": list(learned.clips),
        "command": command_line("kinedex", "template", "show", store.path, choice.name),
        "python": python_lines(store.path, f"store.template({choice.name!r}, {choice.kind!r}).plot()"),
    }


def curve_of_template(store: Store, take_id: int, choice: TemplateChoice) -> npt.NDArray[np.float32]:
    """Return the distance curve of a learned template over a take.

    Parameters
    ----------
    store : Store
        The store of the take.
    take_id : int
        The take.
    choice : TemplateChoice
        The template.

    Returns
    -------
    float32 array (T,)
        The cost of the best match that ends in each frame; ∞ where there is none.

    Raises
    ------
    KinedexError
        There is no such take or template, or the template is not applied to the take.
    """
    words = words_of_take(store, take_id)
    curve: npt.NDArray[np.float32] = distance_curves([_quantised(store, take_id, choice)[0]], words)[0].astype("<f4")
    return curve


def _quantised(store: Store, take_id: int, choice: TemplateChoice) -> tuple[QuantisedTemplate, SubclassTemplate]:
    """Return a template quantised for a take, with the features that are known in it, and the learned template."""
    learned = choose_template(store, choice.name, choice.kind, choice.stage)
    whole = quantise(learned.learned.template, choice.delta)
    if not whole.mask.any():
        raise KinedexError(f"the template '{choice.name}' is wildcards alone at delta {choice.delta:g}; raise delta")
    found = restricted_template(whole, store.known.get(take_id, int(ALL_KNOWN)))
    if found is None:
        raise KinedexError(
            f"the template '{choice.name}' is not applied to this take: its body lacks joints of more than 40 % of the "
            "entries"
        )
    return found, learned


def nearest_hit(store: Store, take_id: int, choice: TemplateChoice, frame: int, tau: float = DEFAULT_TAU) -> Row:
    """Return the hit of a template that is nearest to a frame of a take, with its warping path.

    A hit that contains the frame takes precedence, the cheapest one if there are several; otherwise the hit that ends
    nearest to the frame is returned. If the take has no hit below τ, its cheapest match is returned.

    Parameters
    ----------
    store : Store
        The store of the take.
    take_id : int
        The take.
    choice : TemplateChoice
        The template.
    frame : int
        The analysis frame.
    tau : float
        The threshold of hits.

    Returns
    -------
    dict
        `start`, `stop`, `cost`, `below` (the cost is below τ); `columns`, the column of the template in each frame;
        and `example`: the clip of the template that resembles the hit most, with `take_id`, `take`, `start`, `stop`,
        and for each frame of the hit the frame of the clip's take in `frames`; null where the store has no clip.

    Raises
    ------
    KinedexError
        There is no such take or template, the template is not applied to the take, or it fits nowhere.
    ParameterError
        The take has no such frame.
    """
    check_frame(store, take_id, frame)
    words = words_of_take(store, take_id)
    template, learned = _quantised(store, take_id, choice)
    curve = distance_curves([template], words)[0]
    if not np.isfinite(curve).any():
        raise KinedexError(f"the template '{choice.name}' fits nowhere in this take, which is too short for it")
    ends = local_minima(curve, tau)
    if not len(ends):
        ends = np.array([int(np.argmin(curve))], np.int64)
    near = ends[np.argsort(np.abs(ends - frame - len(template) // 2), kind="stable")][:8]
    paths = curve_paths(template, words, np.sort(near))
    best = min(
        zip(np.sort(near).tolist(), paths, strict=True),
        key=lambda one: (0 if one[1].start <= frame <= one[0] else abs(one[0] - frame), curve[one[0]], one[0]),
    )
    end, path = best
    start, stop = path.start, end + 1
    return {
        "start": start,
        "stop": stop,
        "cost": float(curve[end]),
        "below": bool(curve[end] < tau),
        "columns": np.round(path.columns, 2).tolist(),
        "example": _example(store, learned, words[start:stop]),
    }


def _example(store: Store, learned: SubclassTemplate, hit: U64) -> Row | None:
    """Return the clip of a template that resembles a hit most, None where the store has none of its clips."""
    clips = clips_of(store, learned)
    if not clips:
        return None
    parts = [words_of_take(store, store.take_ids[take])[start:stop] for take, start, stop in clips]
    near = nearest_clips(parts, [hit], len(store.feature_set.features))[0]
    take, start, stop = clips[near.clip]
    return {
        "take_id": store.take_ids[take],
        "take": take,
        "start": start,
        "stop": stop,
        "cost": near.cost if np.isfinite(near.cost) else None,
        "frames": (start + near.frames).tolist(),
    }


def aligned_intervals(store: Store, one: Interval, other: Interval) -> Row:
    """Align two intervals by DTW of their words: return for each frame of the first the frame of the second.

    Parameters
    ----------
    store : Store
        The store of the takes.
    one, other : Interval
        The intervals, each of at most `MAX_ALIGNED` frames.

    Returns
    -------
    dict
        `start` and `stop` of the first, `frames` of the second take, one for each frame of the first, and `cost`: the
        mean fraction of features that differ along the path; all differ in an invalid frame.

    Raises
    ------
    KinedexError
        The store has no take with one of the ids.
    ParameterError
        An interval is empty, not within its take, or too long.
    """
    parts = []
    for name, each in (("the first interval", one), ("the second interval", other)):
        check_interval(store, each, name)
        if each.frames > MAX_ALIGNED:
            raise ParameterError(name, f"of at most {MAX_ALIGNED} frames", each.frames)
        parts.append(words_of_take(store, store.take_ids[each.take])[each.start : each.stop])
    differing = word_differences(parts[0], parts[1], len(store.feature_set.features))
    path = align(differing, np.ones(len(parts[0])), np.ones(len(parts[1]))).path
    frames = np.zeros(len(parts[0]), np.int64)
    frames[path[:, 0]] = path[:, 1]
    return {
        "start": one.start,
        "stop": one.stop,
        "frames": (other.start + frames).tolist(),
        "cost": float(differing[path[:, 0], path[:, 1]].mean()),
    }


def template_choice(request: Request) -> TemplateChoice:
    """Return the template that an address names."""
    asked = request.query_params
    return TemplateChoice(
        asked.get("template", ""),
        kind_of(asked.get("kind", "soft")),
        asked.get("stage"),
        _number(request, "delta", DELTA),
    )


def kind_of(text: str) -> Kind:
    """Return the kind of template that an address names."""
    if text not in ("soft", "hard"):
        raise ParameterError("kind", "soft or hard", text)
    return "hard" if text == "hard" else "soft"


def _number(request: Request, name: str, absent: float) -> float:
    text = request.query_params.get(name)
    try:
        value = absent if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ParameterError(name, f"a number in the address, such as {name}=0.1", text)
    return value


def _image(archive: Archive, request: Request) -> Row:
    return template_image(archive.store(), template_choice(request))


def _curve(archive: Archive, request: Request) -> bytes:
    return curve_of_template(*take_of(archive, request), template_choice(request)).tobytes()


def _hit(archive: Archive, request: Request) -> Row:
    store, take = take_of(archive, request)
    choice, tau = template_choice(request), _number(request, "tau", DEFAULT_TAU)
    found = nearest_hit(store, take, choice, whole_number(request, "frame"), tau)
    where = f"take_id = {take}"
    rank = f"store.rank({choice.name!r}, None, tau={tau:g}, delta={choice.delta:g}, where={where!r})"
    return {**found, "python": python_lines(store.path, rank)}


def _align(archive: Archive, request: Request) -> Row:
    store = archive.store()
    asked = [[whole_number(request, f"{side}{name}") for name in ("take", "start", "stop")] for side in ("", "other_")]
    one, other = (Interval(name_of(store, take), start, stop) for take, start, stop in asked)
    parts = ", ".join(f"store[{take}][{start}:{stop}].words()" for take, start, stop in asked)
    features = len(store.feature_set.features)
    lines = (
        "from kinedex.ops.templates.nearest_clip import word_differences",
        "from kinedex.ops.templates.warping import align",
        f"costs = word_differences({parts}, {features})",
        "align(costs, *(numpy.ones(length) for length in costs.shape)).path",
    )
    return {**aligned_intervals(store, one, other), "python": python_lines(store.path, "import numpy", *lines)}


routes = [
    get_of_take("/templates", templates_of_take),
    get("/api/takes/{take:int}/curve", _curve),
    get("/api/takes/{take:int}/hit", _hit),
    get("/api/template", _image),
    get("/api/align", _align),
]
