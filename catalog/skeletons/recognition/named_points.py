"""Points that a person has named: each is a joint, or a landmark, whatever its label says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, Reading
from kinedex.catalog.skeletons.recognition.point_trunk import BodyDraft, one_point
from kinedex.ops.errors import KinedexError, did_you_mean

NOTHING = "none"
"""The name of a point that is neither a joint nor a landmark."""

_MIDDLE = {"root": "pelvis", "neck": "neckjoint", "head": "headjoint", "headtop": "top"}
_SIDED = {
    "hip": "hipjoint", "knee": "kneejoint", "ankle": "anklejoint", "toes": "toejoint", "clavicle": "collar",
    "shoulder": "shoulderjoint", "elbow": "elbowjoint", "wrist": "wristjoint", "fingers": "knuckles",
}  # fmt: skip

CENTRES: Mapping[str, str] = _MIDDLE | {
    f"{side}{joint}": f"{side}{centre}" for joint, centre in _SIDED.items() for side in "lr"
}
"""A dict from joint to the landmark of its centre, from which other joints are estimated."""


def skin_landmarks(landmarks: Landmarks) -> tuple[str, ...]:
    """Return the landmarks on the skin, in the order in which labels are assigned to them."""
    skin = {landmark for hits in landmarks.skin.values() for landmark, _ in hits}
    return tuple(landmark for landmark in dict.fromkeys(landmarks.order) if landmark in skin)


def check_names(
    named: Mapping[str, str], labels: Sequence[str], known: Sequence[str], many: Sequence[str] = ()
) -> None:
    """Raise a KinedexError for a label that the file lacks, an unknown name, or one name for several points.

    Parameters
    ----------
    named : mapping of str to str
        Label → name.
    labels : sequence of str
        The labels of the file.
    known : sequence of str
        The names that there are, besides `NOTHING`.
    many : sequence of str, optional
        Those of these that several points may have.
    """
    owners: dict[str, str] = {}
    for label, name in named.items():
        if label not in labels:
            raise KinedexError(f"the file has no node '{label}'{did_you_mean(label, labels)}")
        if name == NOTHING:
            continue
        if name not in known:
            raise KinedexError(f"'{label}': there is no joint or landmark '{name}'{did_you_mean(name, known)}")
        if name in owners and name not in many:
            raise KinedexError(f"'{owners[name]}' and '{label}' are both named '{name}'; name one of them '{NOTHING}'")
        owners[name] = label


def named_reading(reading: Reading, landmarks: Landmarks, named: Mapping[str, str]) -> Reading:
    """Return the landmarks of a file, in which the names that a person has given replace those of labels.

    Parameters
    ----------
    reading : Reading
        The landmarks by the labels alone.
    landmarks : Landmarks
        The vocabulary.
    named : mapping of str to str
        Label → joint, landmark or `NOTHING`. A label that loses its landmark has none.
    """
    wanted = {label: CENTRES.get(name, name) for label, name in named.items()}
    taken = {name for name in wanted.values() if name not in landmarks.many}
    labels: dict[str, tuple[str, ...]] = {}
    for landmark, those in reading.labels.items():
        kept = tuple(label for label in those if label not in named)
        if kept and landmark not in taken:
            labels[landmark] = kept
    for label, landmark in wanted.items():
        if landmark in landmarks.order:
            labels[landmark] = (*labels.get(landmark, ()), label)
    centres = {landmark for hits in landmarks.centres.values() for landmark, _ in hits}
    on_skin = set(skin_landmarks(landmarks)) - centres
    used = {label for those in labels.values() for label in those}
    everything = [*(label for those in reading.labels.values() for label in those), *reading.unread]
    unread = tuple(label for label in everything if label not in used)
    arm = {landmark: label for landmark, label in reading.arm.items() if label not in named}
    return Reading(labels, reading.skin or bool(on_skin & set(wanted.values())), unread, reading.sets, arm)


def set_named_joints(draft: BodyDraft, named: Mapping[str, str], joints: Sequence[str]) -> None:
    """Place the joints that a person has named at their points, and discard other estimates of them."""
    for label, name in named.items():
        if name in joints:
            draft.joints[name] = [one_point(label)]
            draft.estimated.pop(name, None)
            draft.rough.discard(name)


def nodes_of_landmarks(reading: Reading) -> dict[str, str]:
    """Return a dict from label to the landmark that it names."""
    return {label: landmark for landmark, labels in reading.labels.items() for label in labels}
