"""A motion is a class of an archive with the data that priors need: template, poses and marks."""

from __future__ import annotations

from dataclasses import dataclass

from kinedex.ops.priors.archive_poses import PoseTable
from kinedex.ops.priors.constraints import Mark
from kinedex.ops.templates.templates import QuantisedTemplate


@dataclass(frozen=True, eq=False)
class Motion:
    """A class of motions with its template, its poses and its marked regions.

    Attributes
    ----------
    name : str
        The name of the class.
    template : QuantisedTemplate
        Its quantised template.
    poses : PoseTable, optional
        The poses of its example clips; None where the archive has templates only.
    marks : tuple of Mark
        The marked regions of the template.
    """

    name: str
    template: QuantisedTemplate
    poses: PoseTable | None = None
    marks: tuple[Mark, ...] = ()
