"""The archive that priors of the studies come from: HDM05's clips with their words and fitted poses."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

import kinedex
from kinedex.catalog.classes import load_classes
from kinedex.catalog.features import load_feature_set
from kinedex.ops.arrays import U64
from kinedex.ops.body.features import words as words_of
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.body.kinematics import quaternions
from kinedex.ops.body.pose_fit import fit_poses, measured_body
from kinedex.ops.priors.archive_poses import PriorMotion, clip_frames, pose_table
from kinedex.ops.priors.constraints import template_marks
from kinedex.ops.templates.templates import learn_soft, quantise
from studies.camera_set import CHAIN

F64 = npt.NDArray[np.float64]

FEATURES = load_feature_set("body40")
DELTA = 0.05


@dataclass(frozen=True, eq=False)
class Clip:
    """An example clip of a class.

    Attributes
    ----------
    name, actor, label : str
        Its name, its actor and its class.
    words : uint64 array (T,)
        Its words.
    joints : float64 array (T, J, 3)
        The joints of the chain in metres.
    """

    name: str
    actor: str
    label: str
    words: U64
    joints: F64

    @cached_property
    def poses(self) -> Poses:
        """The poses of the chain that are fitted to it."""
        positions = np.ascontiguousarray(self.joints.transpose(1, 2, 0))
        return fit_poses(measured_body(CHAIN, positions), positions)


def read_clips(folder: Path) -> list[Clip]:
    """Read the clips of a folder of HDM05, whose files are named HDM_<actor>_<class>_<number>_120.amc."""
    found = []
    for path in sorted(folder.glob("*/*.amc")):
        take = kinedex.read(path)
        order = [take.joints.index(joint) for joint in CHAIN.joints]
        joints = np.asarray(take.positions[:, order], np.float64)
        found.append(Clip(take.name, path.stem.split("_")[1], path.parent.name, take.words(), joints))
    return found


def motions_of(clips: Sequence[Clip], delta: float = DELTA, without: Collection[str] = ()) -> list[PriorMotion]:
    """Return what an archive of clips knows of each class.

    Parameters
    ----------
    clips : sequence of Clip
        The clips.
    delta : float
        δ of the quantisation.
    without : collection of str
        Actors whose clips are no examples.
    """
    bits = {feature.name: index for index, feature in enumerate(FEATURES.features)}
    found = []
    for one in load_classes("hdm05-11", {clip.label for clip in clips}).classes:
        examples = [clip for clip in clips if clip.label in one.subclasses and clip.actor not in without]
        if not examples:
            continue
        template = learn_soft([clip.words for clip in examples], len(FEATURES.features)).template
        quantised = quantise(template, delta)
        table = pose_table([clip.poses for clip in examples], [clip_frames(template, clip.words) for clip in examples])
        found.append(
            PriorMotion(one.name, quantised, table, template_marks(quantised, bits, one.locomotion, one.marks))
        )
    return found


def track_words(body: ChainBody, poses: Poses, rate_hz: float) -> U64:
    """Return the words of a track, whose root is turned as the pelvis is."""
    positions, turned = forward(body, poses)
    order = [CHAIN.joint(joint) for joint in FEATURES.joints]
    orientation = quaternions(turned[:, 0].reshape(-1, 9).T)
    return words_of(positions[order], orientation, rate_hz, FEATURES.rules)
