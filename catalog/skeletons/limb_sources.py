"""The sources that a skeleton mapping names for the orientations of limbs: nodes that turn with them, or markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field, model_validator

from kinedex.catalog.configs import Located
from kinedex.catalog.limbs import LIMB_NAMES, LIMBS
from kinedex.ops.errors import did_you_mean

_OF_NODES = ("acclaim", "bvh", "amass")


@dataclass(frozen=True)
class LimbSource:
    """The source of a limb's orientation.

    Attributes
    ----------
    node : str or None
        The node that turns with the limb.
    markers : tuple of str
        The markers on the limb, three or more, or none.
    axis : tuple of str
        The named joints from which and to which its long axis runs; empty for those of the limb.
    """

    node: str | None = None
    markers: tuple[str, ...] = ()
    axis: tuple[str, ...] = ()

    def ends(self, limb: str) -> tuple[str, str]:
        """Return the near and the far joint of the limb's long axis."""
        if self.axis:
            return self.axis[0], self.axis[1]
        return LIMBS[limb].near, LIMBS[limb].far


class LimbEntry(BaseModel):
    """An entry of `limbs` in a mapping file."""

    model_config = ConfigDict(extra="forbid")
    node: str | None = None
    markers: list[str] | None = Field(None, min_length=3)
    axis: list[str] | None = Field(None, min_length=2, max_length=2)

    @model_validator(mode="after")
    def _one(self) -> LimbEntry:
        if self.node is not None and self.markers is not None:
            raise ValueError("expected `node` or `markers`, not both")
        if self.node is None and self.markers is None and self.axis is None:
            raise ValueError("expected `node` (a node that turns with the limb), `markers` (three or more), or `axis`")
        return self


def limb_sources(
    located: Located, entries: Mapping[str, LimbEntry], form: str, joints: Sequence[str]
) -> dict[str, LimbSource]:
    """Return the sources that a mapping file names for limbs.

    Parameters
    ----------
    located : Located
        The mapping file.
    entries : mapping of str to LimbEntry
        Its `limbs`.
    form : str
        Its format.
    joints : sequence of str
        The named joints.

    Raises
    ------
    ConfigError
        There is no such limb or joint, or the format has no nodes that turn, or no markers.
    """
    found = {}
    for limb, entry in entries.items():
        if limb not in LIMBS:
            raise located.error(
                f"no limb of that name{did_you_mean(limb, LIMB_NAMES)}; the limbs are {', '.join(LIMB_NAMES)}",
                "limbs", limb,
            )  # fmt: skip
        if entry.node is not None and form not in _OF_NODES:
            raise located.error(f"points of format {form} do not turn; give `markers`", "limbs", limb, "node")
        if entry.markers is not None and form in _OF_NODES:
            raise located.error(f"format {form} has no markers; give `node`", "limbs", limb, "markers")
        twice = [name for name in entry.markers or () if (entry.markers or []).count(name) > 1]
        if twice:
            raise located.error(f"'{twice[0]}' is listed twice", "limbs", limb, "markers")
        for joint in entry.axis or ():
            if joint not in joints:
                raise located.error(f"no joint is named '{joint}'{did_you_mean(joint, joints)}", "limbs", limb, "axis")
        if entry.axis and entry.axis[0] == entry.axis[1]:
            raise located.error("the axis must run between two joints", "limbs", limb, "axis")
        found[limb] = LimbSource(entry.node, tuple(entry.markers or ()), tuple(entry.axis or ()))
    return found
