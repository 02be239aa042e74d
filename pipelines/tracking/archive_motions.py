"""Prepare the motions of an archive that provide priors: templates, columns with constraints, and poses of clips."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from kinedex.catalog.classes import Classes
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import U64
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.body.kinematic_chain import Poses
from kinedex.ops.body.pose_fit import fit_poses, measured_body
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.archive_poses import PoseTable, PriorMotion, clip_frames, pose_table
from kinedex.ops.priors.constraints import template_marks
from kinedex.ops.templates.templates import Template, quantise
from kinedex.ops.wording import name_list
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips
from kinedex.storage.snapshot.frames import words_of
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.store import Store


@dataclass(frozen=True, eq=False)
class ClassPoses:
    """The distribution of poses of a class, with the clips that it was computed from.

    Attributes
    ----------
    label : str
        The class.
    clips : tuple of str
        The example clips.
    table : PoseTable
        The mean poses and their spread, by template column.
    fingerprint : str
        A hash of template, clips and code.
    """

    label: str
    clips: tuple[str, ...]
    table: PoseTable
    fingerprint: str


@dataclass(frozen=True, eq=False)
class PosesOfArchive:
    """The distributions of poses of all classes of an archive.

    Attributes
    ----------
    classes : dict of str to ClassPoses
        Class → its poses; classes without usable clips are missing.
    remarks : list of str
        Sentences about clips and classes that were excluded.
    """

    classes: dict[str, ClassPoses]
    remarks: list[str]


@dataclass(frozen=True)
class _Task:
    store: Store
    clips: TrainingClips
    template: Template
    fingerprint: str


def archive_poses(
    store: Store,
    clips: Sequence[TrainingClips],
    templates: Sequence[SubclassTemplate],
    executor: Executor,
    code: str,
    earlier: Iterable[dict[str, Any]] = (),
) -> PosesOfArchive:
    """Fit the kinematic chain to the example clips of every class, and align them with its template.

    Parameters
    ----------
    store : Store
        The store that holds the clips.
    clips : sequence of TrainingClips
        The clips of each class; classes with a template from a file have none.
    templates : sequence of SubclassTemplate
        Soft templates.
    executor : Executor
        Spreads classes over workers.
    code : str
        A hash of the code that runs; results are reused only if it is not empty.
    earlier : iterable of dict
        Rows of the results `archive_poses`, which are reused if their fingerprint is the same.
    """
    known = {row["fingerprint"]: row for row in earlier} if code else {}
    of_class = {one.subclass: one for one in clips}
    found: dict[str, ClassPoses] = {}
    tasks = []
    for one in templates:
        if (own := of_class.get(one.subclass)) is None:
            continue
        task = _Task(store, own, one.learned.template, _fingerprint(store, own, one.learned.template, code))
        if task.fingerprint in known:
            found[one.subclass] = _class_poses(known[task.fingerprint])
        else:
            tasks.append(task)
    remarks = []
    for task, (poses, left) in zip(tasks, executor.map(_fitted, tasks), strict=True):
        remarks += left
        if poses is not None:
            found[task.clips.subclass] = poses
    without = [one.subclass for one in templates if one.subclass not in found]
    if not found:
        remarks.append("the archive has no example clips to take poses from: archive poses are impossible")
    elif without:
        remarks.append(f"no example clips, so no archive poses: {name_list(without)}")
    return PosesOfArchive(dict(sorted(found.items())), remarks)


def archive_motions(
    templates: Sequence[SubclassTemplate],
    poses: PosesOfArchive | None,
    features: FeatureSet,
    classes: Classes,
    delta: float,
) -> list[PriorMotion]:
    """Return the motions of an archive, sorted by name.

    Parameters
    ----------
    templates : sequence of SubclassTemplate
        The templates.
    poses : PosesOfArchive, optional
        The poses of classes; None if poses are not used as priors.
    features : FeatureSet
        The features of the store.
    classes : Classes
        The classes, which state what is locomotion, and change the columns in which a template marks a constraint, such
        as a foot on the ground (`ops.priors.constraints.template_marks`).
    delta : float
        Values of a template within delta of 0 or 1 are fixed.
    """
    bits = {feature.name: feature.number - 1 for feature in features.features}
    of_subclass = {subclass: one for one in classes.classes for subclass in one.subclasses}
    motions = []
    for one in templates:
        template, owner = quantise(one.learned.template, delta), of_subclass.get(one.subclass)
        own = poses.classes.get(one.subclass) if poses is not None else None
        edits = owner.marks if owner is not None else ()
        marks = template_marks(template, bits, owner is not None and owner.locomotion, edits)
        motions.append(PriorMotion(one.subclass, template, own.table if own is not None else None, marks))
    return motions


def poses_table(poses: Iterable[ClassPoses], run: str) -> pa.Table:
    """Return poses of classes as results of the kind `archive_poses`."""
    nodes = load_kinematic_chain().nodes
    rows = [
        {
            "class": one.label,
            "clips": list(one.clips),
            "columns": len(one.table.means),
            "nodes": list(nodes),
            "means": one.table.means.ravel().tolist(),
            "spreads": one.table.spreads.ravel().tolist(),
            "tilts": one.table.tilts.ravel().tolist(),
            "fingerprint": one.fingerprint,
        }
        for one in poses
    ]
    return result_table("archive_poses", rows, run)


def _class_poses(row: dict[str, Any]) -> ClassPoses:
    shape = (row["columns"], len(row["nodes"]))
    table = PoseTable(
        np.array(row["means"]).reshape(*shape, 3, 3),
        np.array(row["spreads"]).reshape(*shape, 3),
        np.array(row["tilts"]).reshape(-1, 3),
        len(row["clips"]),
    )
    return ClassPoses(row["class"], tuple(row["clips"]), table, row["fingerprint"])


def _fingerprint(store: Store, clips: TrainingClips, template: Template, code: str) -> str:
    hasher = hashlib.sha256(repr((code, clips.subclass, clips.names, clips.mirrored)).encode())
    hasher.update(repr([store.checksums.get(take) for take in clips.of_takes]).encode())
    for array in (template.values, *clips.words):
        hasher.update(np.ascontiguousarray(array).tobytes())
    return hasher.hexdigest()[:32]


def _fitted(task: _Task) -> tuple[ClassPoses | None, list[str]]:
    """Return the poses of a class, None if no clip can be used, and remarks on clips that cannot; runs in a worker."""
    clips, remarks = task.clips, []
    names, poses, frames = [], [], []
    for place, name in enumerate(clips.names):
        mirrored = place >= len(clips.names) - clips.mirrored
        try:
            fitted = _clip_poses(task.store, name, clips.words[place], mirrored)
            frames.append(clip_frames(task.template, clips.words[place]))
        except ParameterError as fault:
            remarks.append(f"{clips.subclass}: '{name}' has no joints to take poses from: {fault}")
            continue
        names.append(name)
        poses.append(fitted)
    if not poses:
        return None, remarks
    return ClassPoses(clips.subclass, tuple(names), pose_table(poses, frames), task.fingerprint), remarks


def _clip_poses(store: Store, name: str, words: U64, mirrored: bool) -> Poses:
    """Return the fitted poses of a clip in its valid frames.

    Raises
    ------
    ParameterError
        Its body lacks a joint.
    """
    chain = load_kinematic_chain()
    take, part = interval_of(name, store.take_ids)
    start, stop, _ = part.indices(store.take_frames[store.take_ids[take]])
    rows = store.frames(take, start, stop)
    valid = np.flatnonzero(words_of(rows) != NO_WORD)
    positions = joint_positions(rows, store.feature_set.joints).astype(np.float64)
    positions = positions[:, :, valid[0] : valid[-1] + 1]
    lacking = [joint for joint in chain.joints if joint not in store.feature_set.joints]
    if lacking or positions.shape[2] != len(words):
        raise ParameterError("clip", f"of all joints and {len(words)} frames", f"{lacking}, {positions.shape[2]}")
    joints = positions[[store.feature_set.joints.index(joint) for joint in chain.joints]]
    if mirrored:
        joints = mirrored_positions(joints.transpose(2, 0, 1), chain.joints).transpose(1, 2, 0)
    joints = np.ascontiguousarray(joints)
    return fit_poses(measured_body(chain, joints), joints)
