"""Stage pose_database: collect distinct poses of the archive, for the lookup of depth frames."""

from __future__ import annotations

from typing import ClassVar

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.reconstruction.parameters import PoseDatabaseParameters
from kinedex.pipelines.reconstruction.stored_poses import (
    build_pose_database,
    listed_takes,
    pose_tables,
    read_pose_database,
    take_tables,
)
from kinedex.storage.store.store import Store


class BuildPoseDatabase(Stage[PoseDatabaseParameters]):
    """Collects distinct poses of the archive, for the lookup of depth frames (thesis, Section 8.3.3)."""

    name = "pose_database"
    parameters = PoseDatabaseParameters
    inputs: ClassVar = {"takes": Input("ingest", optional=True)}

    def reading(self, params: PoseDatabaseParameters, store: Store) -> Reading:
        """Return a digest of the takes from which poses are collected."""
        takes = listed_takes(store, params.where, "")
        return Reading(hash_of([(one.take, one.actor, one.fingerprint) for one in takes]), counted(len(takes), "take"))

    def run(self, context: StageContext, params: PoseDatabaseParameters) -> dict[str, object]:
        """Select distinct poses from takes that are new or changed, and store the database."""
        store = context.open()
        takes = listed_takes(store, params.where, context.code)
        if not takes:
            raise KinedexError(
                f"where: no take fits '{params.where}'; `kinedex sql STORE 'FROM takes'` lists what there is, and "
                f"`--set {context.stage}.where=true` takes all"
            )
        earlier = None
        if not context.anew:
            try:
                earlier = read_pose_database(store, context.key())
            except KinedexError as fault:
                context.message(f"all takes are read: {fault}")
        made = build_pose_database(store, takes, params.distance_m, earlier, context.message, context.progress)
        context.put_results(poses=pose_tables(made, context.run), pose_takes=take_tables(made, context.run))
        frames = sum(int((one.stands_for >= 0).sum()) for one in made.takes)
        poses = sum(len(one.rows) for one in made.takes)
        lacking = [one.take for one in made.takes if one.bone_lengths is None]
        megabytes = sum(one.directions.nbytes for one in made.takes) / 1e6
        context.message(
            f"{counted(frames, 'frame')} of {counted(len(takes), 'take')} → {counted(poses, 'pose')}, "
            f"{megabytes:.1f} MB; {counted(made.read, 'take')} read"
        )
        if lacking:
            context.message(f"warning: {counted(len(lacking), 'take')} without all named joints provide no pose")
        return {"takes": len(takes), "frames": frames, "poses": poses, "read": made.read, "lacking": len(lacking)}
