"""The nodes of one source file, the body that names of nodes make, and mappings that a store keeps.

A file is given by {source_root, source, person?} as the view `doubts` or `takes` of the store has it; no other file is
read. `named` is {node: joint, landmark or "none"}.

POST /api/files/nodes {file, named} → {format, nodes: [{node, name, reason, joints}], names: [text], joints,
    parents: [index or −1] or null, frames: [[[x, y, z] or null] of nodes], up, refused, proposed_name, python, command}
POST /api/files/trial {file, named, name, only_this} → {yaml, fault, frames of joints, unknown, estimated, figures,
    words, warnings, around: {folder, takes}, commands: [text]}
POST /api/files/mapping {file, named, name, only_this} → {name, replaced, job}: keeps the mapping, and reads its source

Frames are at most 32, spread evenly; those of nodes are in the axes and the unit of the file, those of joints in
metres, Y up.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field
from starlette.requests import Request

from kinedex.catalog.quality import quality_warnings
from kinedex.catalog.quality_figures import FIGURES
from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES
from kinedex.catalog.skeletons.mappings import Mappings, OwnFile, load_mappings, own_files, with_own
from kinedex.catalog.skeletons.named_nodes import guessed_fit, is_tree, named_fit, node_guesses, node_names
from kinedex.explorer.answers import NotFoundError, command_line
from kinedex.explorer.endpoints import RequestBody, post
from kinedex.explorer.jobs import Job, jobs_of
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.store import parents_of
from kinedex.ops.arrays import F64
from kinedex.ops.cache import Cache
from kinedex.ops.errors import KinedexError
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.ingestion.analysis import analyse, figures_of, unknown_feature_warnings
from kinedex.pipelines.ingestion.parameters import IngestParameters, stored_files
from kinedex.pipelines.inspection.feature_shares import feature_shares
from kinedex.pipelines.inspection.mapping_proposal import proposed_text
from kinedex.storage.formats.motion.file_nodes import FileNodes, read_file_nodes
from kinedex.storage.formats.motion.packed_files import container_of, split_ending
from kinedex.storage.formats.motion.reader import Body, MotionFile
from kinedex.storage.formats.motion.reader_table import persons_of
from kinedex.storage.formats.motion.sources import scan
from kinedex.storage.formats.motion.unpacked_files import unpacked
from kinedex.storage.formats.source_files import stamp_of
from kinedex.storage.lock import Wait
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

MAX_AROUND = 100
"""Maximum number of takes of the same folder whose figures and words stand beside those of a file."""

MAX_NODES = 1000
"""Maximum number of nodes of a file that can be named on the page."""

_PERSONS: Cache[tuple[object, ...], tuple[str, ...]] = Cache(64)
"""The persons of the files that were shown last."""

_KEPT: Cache[tuple[object, ...], FileNodes] = Cache(4)
"""The nodes of the files that were read last."""

PATIENCE = Wait(30.0)
"""The time to wait for a job that writes to the store."""

_NAME = r"^\w[\w .()+-]*$"


class SourceFileName(RequestBody):
    """A source file of the store, or one person of it."""

    source_root: str
    source: str
    person: str = ""


class NodesRequest(RequestBody):
    """A file, and the nodes of it that a person has named."""

    file: SourceFileName
    named: Annotated[dict[str, str], Field(default_factory=dict, max_length=MAX_NODES)]


class MappingRequest(NodesRequest):
    """A mapping of named nodes, for all files that have them or for files of one name alone."""

    name: Annotated[str, Field(max_length=100, pattern=_NAME)]
    only_this: bool = False

    @property
    def only(self) -> str | None:
        """The pattern of file names for the key `only` of the mapping; None if the mapping is for all files."""
        # a reader gets a packed file by its name without the ending of the packing
        return f"^{re.escape(''.join(split_ending(PurePosixPath(self.file.source).name)))}$" if self.only_this else None


@dataclass(frozen=True)
class _File:
    """A file that the store knows, with the settings of its source."""

    path: Path
    person: str
    params: IngestParameters


def _known_file(store: Store, asked: SourceFileName) -> _File:
    """Return a file that the store has read or tried to read.

    Raises
    ------
    NotFoundError
        The store knows no such file.
    """
    place = (asked.source_root, asked.source)
    files = store.result("source_files")
    here = pc.and_(pc.equal(files.column("source_root"), place[0]), pc.equal(files.column("source"), place[1]))
    if not files.filter(here).num_rows:
        rows = store.take_rows.select(["source_root", "source"])
        here = pc.and_(pc.equal(rows.column("source_root"), place[0]), pc.equal(rows.column("source"), place[1]))
        if not rows.filter(here).num_rows:
            raise NotFoundError(f"this store has no file {asked.source} of {asked.source_root}; read its folder again")
    source = store.manifest.sources.get(asked.source_root)
    settings = dict(source.settings) if source is not None else {"source": asked.source_root}
    return _File(Path(*place), asked.person, IngestParameters.model_validate(settings))


def _mappings(store: Store, params: IngestParameters, own: OwnFile | None = None) -> Mappings:
    """Return the mappings with which the files of a source are read, and one more that is tried."""
    stored = stored_files(store.path, store.manifest.mappings)
    files = (*([own] if own is not None else []), *own_files(params.skeletons), *stored)
    joints = store.feature_set.joints
    mappings = load_mappings(params.skeleton, joints)
    return with_own(mappings, files, joints) if files else mappings


def _skeleton(file: _File) -> Path | None:
    """Return the ASF or the static trial that the settings of a source give a file; None if its name tells."""
    if not file.params.skeleton_files:
        return None
    found = scan(file.params.source)
    motion = next((one for one in found.motions if one.absolute == file.path), None)
    chosen = found.chosen_skeleton(motion, file.params.skeleton_files)[0] if motion is not None else None
    return chosen.absolute if chosen is not None else None


def _read(file: _File, mappings: Mappings) -> FileNodes:
    root, given = Path(file.params.source), file.params.given
    return read_file_nodes(file.path, mappings, file.person, root, given, _skeleton(file))


def _state(store: Store, file: _File) -> tuple[object, ...]:
    """Return what the nodes of a file depend on: the file and its content, and the mappings of the store."""
    stamp = stamp_of(container_of(file.path) or file.path)
    return file.path, file.person, stamp, str(store.path), store.manifest.version


def _persons(store: Store, file: _File, mappings: Mappings) -> tuple[str, ...]:
    """Return the names of the persons in a file; empty if it has only one."""
    key = _state(store, file)
    kept = _PERSONS.get(key)
    if kept is not None:
        return kept
    with unpacked(file.path) as copy:
        return _PERSONS.put(key, persons_of(MotionFile(copy.path), mappings))


def _nodes_of(store: Store, file: _File, mappings: Mappings) -> FileNodes:
    """Return the nodes of a file, which are kept for the next request until the file or the store changes."""
    key = _state(store, file)
    kept = _KEPT.get(key)
    return kept if kept is not None else _KEPT.put(key, replace(_read(file, mappings), body=None))


def nodes(archive: Archive, asked: NodesRequest, _request: Request) -> dict[str, Any]:
    """Return the nodes of a file, what each is taken for, and where they are in some frames."""
    store = archive.store()
    file = _known_file(store, asked.file)
    mappings = _mappings(store, file.params)
    persons = _persons(store, file, mappings) if file.path.suffix.lower() != ".amc" else ()
    if persons and not file.person:
        file = replace(file, person=persons[0])
    found = _nodes_of(store, file, mappings)
    fit = named_fit(found.asked, mappings, asked.named) if asked.named else guessed_fit(found.asked, mappings)
    guesses = node_guesses(found.asked, mappings, fit, asked.named)
    if len(guesses) > MAX_NODES:
        raise KinedexError(f"{file.path}: has {len(guesses):,} nodes; at most {MAX_NODES:,} can be named here")
    evidence = found.asked.evidence
    stem = re.sub(r"[^\w .()+-]", "_", file.path.stem).lstrip(" .()+-_") or "mapping"
    return {
        "format": found.asked.form,
        "nodes": [{"node": one.node, "name": one.name, "reason": one.reason, "joints": one.joints} for one in guesses],
        "names": node_names(found.asked, mappings),
        "can_be_named": evidence is not None,
        "parents": evidence.parents if evidence is not None and is_tree(found.asked) else None,
        "frames": _frames(evidence.positions) if evidence is not None else [],
        "up": fit.up if fit is not None else "y",
        "persons": persons,
        "person": file.person,
        "refused": None if found.fault is None else found.fault.reason,
        "proposed_name": stem[:100],
        "command": command_line("kinedex", "mapping", "nodes", file.path, *_person(file)),
    }


def _person(file: _File) -> list[str]:
    return ["--person", file.person] if file.person else []


def _frames(positions: F64) -> list[list[list[float] | None]]:
    """Return positions (N, 3, K) as K lists of places, None where one is unknown."""
    places = np.round(np.moveaxis(positions, 2, 0), 5)
    return [[place if all(map(math.isfinite, place)) else None for place in frame] for frame in places.tolist()]


def _proposal(store: Store, file: _File, asked: MappingRequest) -> str:
    """Return the mapping that the names of nodes make, as YAML."""
    mappings = _mappings(store, file.params)
    found = _nodes_of(store, file, mappings)
    return proposed_text(found, mappings, file.path, asked.name, file.person, asked.named, asked.only)


def trial(archive: Archive, asked: MappingRequest, _request: Request) -> dict[str, Any]:
    """Return the body of a file by a mapping that is not kept yet, compared with the takes of the same folder."""
    store = archive.store()
    file = _known_file(store, asked.file)
    text = _proposal(store, file, asked)
    fault, body = "", None
    try:
        read = _read(file, _mappings(store, file.params, OwnFile(Path(f"{asked.name}.yaml"), text)))
        fault, body = "" if read.fault is None else read.fault.reason, read.body
    except KinedexError as refused:
        fault = str(refused)
    if body is not None and body.skeleton != asked.name:
        fault, body = (
            f"the file is read by the mapping '{body.skeleton}', which fits all its nodes; remove it first",
            None,
        )
    around = _around(store, asked.file)
    answer = {
        "yaml": text,
        "fault": fault or None,
        "around": {"folder": around[0], "takes": len(around[1])},
        "commands": _commands(archive, file, asked),
    }
    if body is None:
        return answer | dict.fromkeys(("frames", "unknown", "estimated", "figures", "words", "warnings"), ())
    with archive.kernels:
        return answer | _judged(store, body, around[1])


def _judged(store: Store, body: Body, around: list[int]) -> dict[str, Any]:
    """Return the joints, figures, words and warnings of a body, with those of other takes."""
    features, joints = store.feature_set, store.feature_set.joints
    shown = np.unique(np.linspace(0, body.frames - 1, min(body.frames, SAMPLED_FRAMES)).astype(int))
    figures = figures_of(body, joints)
    words = analyse(body, features, store.rate_hz)[2]
    shares = feature_shares(words, store.rate_hz, features, body.unknown)
    others = _shares_around(store, around)
    rows = store.take_rows.filter(pc.is_in(store.take_rows.column("take_id"), pa.array(around, pa.int64())))
    compared = []
    for figure in (one for one in FIGURES if one.type == "DOUBLE"):
        known = rows.column(figure.name).drop_null().to_numpy() if figure.name in rows.column_names else np.empty(0)
        value = float(getattr(figures, figure.name))
        compared.append(
            {
                "figure": figure.name, "meaning": figure.meaning, "unit": figure.unit, "value": value,
                "limits": figure.limits(), "off": figure.off(value), "advice": figure.advice,
                "around": [float(part) for part in np.percentile(known, [0, 50, 100])] if len(known) else None,
            }
        )  # fmt: skip
    lines = zip(shares.column("name").to_pylist(), shares.column("percent").to_pylist(), strict=True)
    unknown = ["unknown" in (remark or "") for remark in shares.column("remark").to_pylist()]
    return {
        "frames": _frames(body.positions[:, :, shown]),
        "unknown": body.unknown,
        "estimated": body.estimated,
        "figures": compared,
        "words": [
            {"feature": name, "percent": None if lost else share, "around": beside}
            for (name, share), lost, beside in zip(lines, unknown, others, strict=True)
        ],
        "invalid_frames": int(np.count_nonzero(words == NO_WORD)),
        "parents": parents_of(joints),
        "joints": joints,
        "warnings": [
            *body.warnings, *unknown_feature_warnings(features, body), *quality_warnings(figures, body.rate_hz),
        ],
    }  # fmt: skip


def _around(store: Store, asked: SourceFileName) -> tuple[str, list[int]]:
    """Return a place and the ids of takes of its other files: the file's folder, else its source, else the store."""
    rows = store.take_rows.select(["take_id", "source_root", "source"]).to_pylist()
    others = [row for row in rows if (row["source_root"], row["source"]) != (asked.source_root, asked.source)]
    source = [row for row in others if row["source_root"] == asked.source_root]
    parent = PurePosixPath(asked.source).parent
    folder = [row for row in source if PurePosixPath(row["source"]).parent == parent]
    place, found = (str(Path(asked.source_root) / parent), folder) if folder else (asked.source_root, source)
    place, found = (place, found) if found else ("the store", others)
    return place, [row["take_id"] for row in found[:MAX_AROUND]]


def _shares_around(store: Store, takes: list[int]) -> list[float | None]:
    """Return the percentage of valid frames of some takes in which each feature is on; None where none knows it."""
    count = len(store.feature_set.features)
    if not takes:
        return [None] * count
    words = store.words(sorted(takes))
    lengths = np.diff(words.offsets)
    known = words.known if words.known is not None else np.full(len(words), NO_WORD, np.uint64)
    masks, valid = np.repeat(known, lengths), words.words != NO_WORD
    shares: list[float | None] = []
    for bit in range(count):
        shift = np.uint64(bit)
        seen = valid & (masks >> shift & np.uint64(1)).astype(bool)
        on = (words.words[seen] >> shift & np.uint64(1)).astype(bool)
        shares.append(float(100 * on.mean()) if len(on) else None)
    return shares


def _commands(archive: Archive, file: _File, asked: MappingRequest) -> list[str]:
    """Return the commands that try, keep and use a mapping."""
    yaml = f"{asked.name}.yaml"
    named = [word for node, name in asked.named.items() for word in ("--name", f"{node}={name}")]
    only = ["--only", asked.only] if asked.only is not None else []
    new: list[str | Path] = ["kinedex", "mapping", "new", file.path, "-o", yaml, *_person(file), *named, *only]
    return [
        command_line(*new),
        command_line("kinedex", "inspect", file.path, "--skeleton", yaml),
        command_line("kinedex", "mapping", "add", archive.path, yaml),
        command_line("kinedex", "ingest", archive.path, file.params.source),
    ]


def keep(archive: Archive, asked: MappingRequest, _request: Request) -> dict[str, Any]:
    """Keep a mapping in the store, and start to read the source of its file again."""
    store = open_store(archive.path, at="newest")
    file = _known_file(store, asked.file)
    text = _proposal(store, file, asked)
    # a mapping that cannot be read would end every later ingest
    _mappings(store, file.params, OwnFile(Path(f"{asked.name}.yaml"), text))
    with StoreWriter.open(store.path, store.feature_set, store.rate_hz, PATIENCE) as writer:
        replaced = asked.name in writer.manifest.mappings
        writer.put_mapping(asked.name, text)
        writer.commit()
    words = ("ingest", str(archive.path), file.params.source, "--executor", "serial", "--wait", "10m")
    job = jobs_of(archive).add(Job(f"Read {Path(file.params.source).name} again", words, steps=2))
    return {"name": asked.name, "replaced": replaced, "job": job.shown(), "commands": _commands(archive, file, asked)}


routes = [
    post("/api/files/nodes", nodes, NodesRequest),
    post("/api/files/trial", trial, MappingRequest),
    post("/api/files/mapping", keep, MappingRequest, writes=True),
]
