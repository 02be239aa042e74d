"""Define the limbs that wear sensors, with their joints, sides and groups (thesis, Section 7.5)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from kinedex.ops.errors import KinedexError, did_you_mean


@dataclass(frozen=True)
class Limb:
    """A rigid segment of the body, from a near to a far joint.

    Attributes
    ----------
    name : str
        The name in files, tables and commands, such as `lshank`.
    near, far : str
        The named joints at its ends.
    bend : str or None
        The third joint of hip-knee-ankle or shoulder-elbow-wrist, which with the two ends determines the plane of the
        hinge. None if positions do not determine the rotation about the limb's long axis.
    group : str
        The group of limbs in evaluations, such as `legs`.
    """

    name: str
    near: str
    far: str
    bend: str | None
    group: str

    @property
    def side(self) -> str:
        """The side of the body: `l`, `r`, or empty for a limb in the middle."""
        return "" if self.name in ("pelvis", "torso", "head") else self.name[0]

    @property
    def opposite(self) -> str:
        """The name of the corresponding limb on the other side; that of the limb itself if it has no side."""
        return {"": "", "l": "r", "r": "l"}[self.side] + self.name[len(self.side) :]


def _sided(name: str, near: str, far: str, bend: str | None, group: str) -> tuple[Limb, ...]:
    return tuple(
        Limb(f"{side}{name}", f"{side}{near}", f"{side}{far}", bend and f"{side}{bend}", group) for side in "lr"
    )


_ALL = (
    Limb("pelvis", "root", "belly", None, "trunk"),
    Limb("torso", "chest", "neck", None, "trunk"),
    Limb("head", "head", "headtop", None, "head"),
    *_sided("upperarm", "shoulder", "elbow", "wrist", "arms"),
    *_sided("forearm", "elbow", "wrist", "shoulder", "arms"),
    *_sided("hand", "wrist", "fingers", None, "hands"),
    *_sided("thigh", "hip", "knee", "ankle", "legs"),
    *_sided("shank", "knee", "ankle", "hip", "legs"),
    *_sided("foot", "ankle", "toes", None, "legs"),
)

LIMBS = {limb.name: limb for limb in _ALL}
"""A dict from name to limb, ordered from the trunk outwards."""

LIMB_NAMES = tuple(LIMBS)
"""The names of all limbs."""

GROUPS = {
    group: tuple(limb.name for limb in _ALL if limb.group == group)
    for group in dict.fromkeys(one.group for one in _ALL)
}
"""A dict from group to the names of its limbs: trunk, head, arms, hands and legs."""

WORN = ("torso", "lhand", "rhand", "lshank", "rshank")
"""The limbs with a sensor in the recordings of the thesis (Section 7.6)."""


def limb_of(name: str) -> Limb:
    """Return a limb by its name.

    Parameters
    ----------
    name : str
        One of `LIMB_NAMES`.

    Raises
    ------
    KinedexError
        No limb has this name; the message suggests the nearest.
    """
    if name not in LIMBS:
        raise KinedexError(
            f"no limb is named '{name}'{did_you_mean(name, LIMB_NAMES)}; the limbs are {', '.join(LIMB_NAMES)}"
        )
    return LIMBS[name]


def chosen_limbs(names: Iterable[str]) -> tuple[str, ...]:
    """Expand names of limbs and groups to names of limbs, in the order of `LIMBS`; all limbs if there are no names.

    Parameters
    ----------
    names : iterable of str
        Names of limbs, or of groups such as `legs`.

    Raises
    ------
    KinedexError
        A name denotes neither a limb nor a group.
    """
    chosen: set[str] = set()
    for name in names:
        chosen.update(GROUPS[name] if name in GROUPS and name not in LIMBS else (limb_of(name).name,))
    return tuple(name for name in LIMB_NAMES if not chosen or name in chosen)
