"""Simulate sensors on stored takes: for a command, from the source files, and for a stage, from stored limbs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from kinedex.catalog.limbs import chosen_limbs
from kinedex.pipelines.inertial.limb_sources import limb_tasks, read_limbs, with_stored_body
from kinedex.pipelines.inertial.limb_tables import stored_limbs
from kinedex.pipelines.simulation.chosen_takes import chosen_takes
from kinedex.pipelines.simulation.imu_recordings import Progress, Request, Simulated, TakeToSimulate, write_data_set
from kinedex.pipelines.simulation.imu_windows import take_segments
from kinedex.pipelines.simulation.new_folder import new_folder, require_new
from kinedex.storage.store.store import Store


def simulate_imu(
    store: Store, takes: Sequence[str], where: str | None, request: Request, folder: Path, progress: Progress
) -> Simulated:
    """Write a data set of simulated sensors on takes, whose source files are read again.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects further ones.
    request : Request
        The sensors.
    folder : Path
        A folder that does not exist, or is empty.
    progress : callable
        Shows progress.

    Raises
    ------
    KinedexError
        The folder contains files, there is no such take, or a source no longer exists or was changed.
    """
    require_new(folder)
    names = chosen_takes(store, takes, where)
    tasks = limb_tasks(store, names, chosen_limbs(request.limbs))
    actors, segments = actors_of(store), take_segments(store)

    def found() -> Iterator[TakeToSimulate]:
        for task in tasks:
            read = read_limbs(with_stored_body(task, store))
            yield TakeToSimulate(
                task.take, actors.get(task.take), read.limbs, read.rate_hz, tuple(segments.get(task.take, ()))
            )

    with new_folder(folder) as unfinished:
        return write_data_set(unfinished, names, found(), request, progress)


def simulate_stored(
    store: Store, stage: str, names: Sequence[str], request: Request, folder: Path, progress: Progress
) -> Simulated:
    """Write a data set of simulated sensors into an empty folder, from the limbs that a stage has stored.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage that has stored the limbs, "<pipeline>/<stage>".
    names : sequence of str
        Names of the takes.
    request : Request
        The sensors.
    folder : Path
        An empty folder.
    progress : callable
        Shows progress.
    """
    actors, segments = actors_of(store), take_segments(store)
    takes: Iterable[TakeToSimulate] = (
        TakeToSimulate(one.take, actors.get(one.take), one.limbs, one.rate_hz, tuple(segments.get(one.take, ())))
        for one in stored_limbs(store, stage, names)
    )
    return write_data_set(folder, list(names), takes, request, progress)


def actors_of(store: Store) -> dict[str, str | None]:
    """Return the actor of each take, by the take's name."""
    return {row["name"]: row["actor"] for row in store.take_rows.select(["name", "actor"]).to_pylist()}
