"""The reader of BVH files: named joints and orientation from the channels of the file's own skeleton."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.ops.body import kinematics
from kinedex.storage.formats.motion.bvh_parser import BvhFile
from kinedex.storage.formats.motion.mapped_body import (
    mapped_orientation,
    posed,
    posed_bytes,
    refuse_far,
    to_metres,
    virtual_joint_warnings,
)
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings, file_size


class BvhReader(Reader):
    """Reads BVH files, which carry their own skeleton and rate."""

    format: ClassVar[Format] = "bvh"
    endings: ClassVar[tuple[str, ...]] = (".bvh",)
    reads_whole: ClassVar[bool] = True

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rate that replaces the file's, the only setting that counts."""
        return settings.override_rate_hz

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames; the memory is that of the joints, and of a block of the text."""
        bvh = BvhFile(file.path, file.data)
        need = posed_bytes(bvh.frames, file_size(file.path), len(bvh.nodes), joints) + 1000 * len(bvh.nodes)
        return Extent(bvh.frames, need, settings.rate_of(bvh.rate_hz, []))

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a BVH file, which carries its own skeleton and rate.

        Raises
        ------
        SourceError
            The file is damaged, or no mapping fits; the error names the line of the first fault.
        """
        bvh = BvhFile(file.path, file.data)
        fit = mappings.detect(file.path, "bvh", bvh.places)
        nodes, restored = _restore(bvh, fit)
        positions, turned = posed(bvh, nodes, fit.root, fit, joints)
        warnings = [*bvh.warnings, *virtual_joint_warnings(fit)]
        rate_hz = settings.rate_of(bvh.rate_hz, warnings)
        if restored:
            warnings.append(
                f"bones {', '.join(restored)} have no length in the file; mapping '{fit.mapping.name}' gives them one"
            )
        unit = to_metres(file.path, positions, fit.mapping.unit_m, joints, warnings)
        refuse_far(file.path, positions, joints, fit.unknown)
        return Body(
            positions=positions,
            orientation=mapped_orientation(fit, turned),
            rate_hz=rate_hz,
            unit=unit,
            skeleton=fit.mapping.name,
            unknown=fit.unknown,
            warnings=tuple(warnings),
        )


def _restore(bvh: BvhFile, fit: Fit) -> tuple[tuple[kinematics.Node, ...], list[str]]:
    """Return the nodes, bones without length with that of the mapping, and the names of those bones."""
    nodes, restored = list(bvh.nodes), []
    for name, weights in fit.mapping.bones.items():
        index = fit.places[name]
        moved = any(step.kind >= kinematics.MOVE_X for step in nodes[index].steps)
        if not moved and not nodes[index].before.any():
            offset = sum(weight * bvh.nodes[fit.places[other]].before for other, weight in weights.items())
            nodes[index] = replace(nodes[index], before=np.asarray(offset))
            restored.append(name)
    return tuple(nodes), restored
