"""Export one take to one file."""

from __future__ import annotations

from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.export.clips import Clip
from kinedex.pipelines.export.forms import form_named
from kinedex.pipelines.export.plan import jobs_of, needed_mappings
from kinedex.pipelines.export.request import How
from kinedex.pipelines.export.selection import Interval
from kinedex.pipelines.export.work import Batch, write_files
from kinedex.storage.store.store import Store


def export_take(store: Store, take: str, how: How, path: Path) -> list[Path]:
    """Write a whole take to a file, completely or not at all.

    Parameters
    ----------
    store : Store
        The store that has the take.
    take : str
        The take's name.
    how : How
        The format, and whether the motion is resampled or moved to the origin.
    path : Path
        The file to write; an existing one is replaced. Formats of several files write the others beside it.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    KinedexError
        There is no such take, it cannot be written in this format, the request makes a data set, or the file cannot be
        written.
    """
    asked = {
        "mirror": how.mirror, "split": how.split, "balance": how.balance, "per-class": how.per_class,
        "distinct": how.distinct, "margin": how.margin, "context": how.context, "min-length": how.min_length,
    }  # fmt: skip
    if given := [name for name, value in asked.items() if value]:
        raise KinedexError(f"--{given[0]} makes a data set: give its folder, as in -o clips/")
    frames = store.take_frames[store.take_id(take)]
    clip = Clip(Interval(take, 0, frames), 0, frames, 0, frames, None, name=take)
    (job,) = jobs_of(store, [clip], how)
    endings = form_named(how.form).endings[: len(job.files)]
    paths = [path, *(path.with_suffix(f".{ending}") for ending in endings[1:])]
    batch = Batch(store, path.parent, how, needed_mappings(store, (job,)), (job,))
    write_files(batch, job, paths, None if job.channels else store.frames(take))
    return paths
