"""SIGKILL before every kind of system call by which a store changes, spread evenly over the phases of its life.

Each work (an ingest, a compaction, a build of the index, a stage, a garbage collection, …) runs once undisturbed, and
then again and again on the same store, killed before one of its calls. Afterwards the store must show the version whose
manifest had been published, without a fault, and the work, run again, must end with the same content.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from kinedex.ops.errors import KinedexError
from kinedex.storage.index.generations import current_generation
from kinedex.storage.snapshot.manifest_files import read_newest, read_version, versions
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.attacks.outcome import Options, Outcome
from tests.attacks.system_calls import Call, available, watched
from tests.attacks.warm_workers import Kernel, Workers, asked, compiled, load_kernels
from tests.attacks.works import WORKS, Work
from tests.attacks.written_content import contents, reports

KILLS = {"sample": 18, "ordinary": 300, "nightly": 1200}
"""The number of kills of each size."""

SAMPLED = ("later ingest", "gc", "upgrade")
"""The works that a sample kills."""

PHASES = {
    "manifest": "commit", "frames": "frames parts", "takes": "takes parts", "lock": "opening",
}  # fmt: skip


def phase(call: Call, store: str) -> str:
    """Return the phase of a work that a call belongs to, by the place that it changes."""
    path = os.path.relpath(call.path, store)
    top = path.split("/")[0]
    if call.name.startswith("mkdir") or path in ("index/lock", "."):
        return "opening"
    if top == "index":
        kinds = {".slices": "index shards", ".duckdb": "index file", ".wal": "index file"}
        return kinds.get(os.path.splitext(path)[1], "index publication")
    if path.startswith("results/reports"):
        return "report files"
    return PHASES.get(top, top)


@dataclass(frozen=True)
class Undisturbed:
    """A work as it goes when nobody disturbs it.

    Attributes
    ----------
    phases : list of str
        The phase of each call.
    before : dict of int to dict
        The content of each version of the store as it is before.
    after : dict of int to dict
        The content of each version that it holds afterwards.
    end : dict
        The content of the newest version, with index and reports.
    reports : dict
        The report files as they are before.
    kernels : list of tuple
        The compiled functions that it needs, with their signatures.
    """

    phases: list[str]
    before: dict[int, dict[str, str]]
    after: dict[int, dict[str, str]]
    end: dict[str, str]
    reports: dict[str, str]
    kernels: list[tuple[Kernel, list[Any]]]


def run(folder: Path, options: Options) -> Outcome:
    """Kill every work, as often in each of its phases."""
    if not available():
        return Outcome({"skipped, calls can be watched on Linux on x86-64 alone": 1})
    works = SAMPLED if options.size == "sample" else tuple(WORKS)
    return attack(folder, options.seed, KILLS[options.size], works, only=options.case)


def attack(
    folder: Path, seed: int, kills: int, works: Sequence[str] = tuple(WORKS), only: str | None = None, jobs: int = 2
) -> Outcome:
    """Kill works at a number of moments.

    Parameters
    ----------
    folder : Path
        An empty folder to work in.
    seed : int
        Seed of the moments.
    kills : int
        How many times to kill, over all works.
    works : sequence of str
        The works to kill.
    only : str or None
        One case, "work:number of the call", in place of all of these.
    jobs : int
        Works that are killed at the same time.

    Returns
    -------
    Outcome
        The number of kills in each phase of each work, and the stores that did not survive one.
    """
    if only is not None:
        works = [only.partition(":")[0]]
    outcome, found = Outcome({"kills": 0}), dict[str, Undisturbed]()
    with Workers(jobs) as workers:
        for name, undisturbed in workers.each(_undisturbed, [(folder, name) for name in works]):
            if isinstance(undisturbed, Undisturbed):
                found[name] = undisturbed
            else:
                outcome.fail(f"{name}:0", f"undisturbed: {undisturbed}")
        moments = _moments(found, kills, seed)
        if only is not None:
            moments = [(works[0], int(only.partition(":")[2]))] if found else []
        cases = [(folder, name, found[name], moment) for name, moment in moments]
        for name, (moment, label, problem) in workers.each(_killed, cases):
            outcome.count("kills", label != "")
            if label:
                outcome.count(f"{name}: {label}")
            if problem:
                outcome.fail(f"{name}:{moment}", f"{name}, killed in {label or 'no phase'}: {problem}")
    order = {"kills": 0, **{name: place for place, name in enumerate(works, 1)}}
    outcome.cases = outcome.counts["kills"]
    outcome.counts = dict(sorted(outcome.counts.items(), key=lambda item: order[item[0].partition(":")[0]]))
    return outcome


def _moments(found: dict[str, Undisturbed], kills: int, seed: int) -> list[tuple[str, int]]:
    """Return the calls before which works are killed: as many in every phase, spread evenly over its calls."""
    moments = []
    for (name, label), count in _shares(found, kills).items():
        calls = [number for number, other in enumerate(found[name].phases) if other == label]
        offset = Random(f"{seed}/{name}/{label}").random()
        moments += [(name, calls[int((k + offset) * len(calls) / count)]) for k in range(count)]
    return sorted(moments)


def _shares(found: dict[str, Undisturbed], kills: int) -> dict[tuple[str, str], int]:
    """Divide kills evenly among phases; the share that a phase of few calls cannot take goes to the others."""
    phases = Counter((name, label) for name, undisturbed in found.items() for label in undisturbed.phases)
    shares, left = dict[tuple[str, str], int](), kills
    for rank, (key, calls) in enumerate(sorted(phases.items(), key=lambda item: (item[1], item[0]))):
        shares[key] = min(calls, max(1, round(left / (len(phases) - rank))))
        left -= shares[key]
    return shares


def _undisturbed(folder: Path, name: str) -> Undisturbed | str:
    """Prepare a work, run it once, and record its calls and the versions that it makes."""
    work, base = WORKS[name], folder / name.replace(" ", "-")
    base.mkdir()

    def once() -> tuple[Any, ...]:
        work.prepare(base)
        before: dict[int, dict[str, str]] = {}
        if (base / "store").exists():
            before = {read_newest(base / "store").version: {}} if work.damaged else _versions(base / "store")
        place = _copy(base, folder)
        work.run(base, place)
        return before, _versions(place), _end(place), reports(base / "store"), compiled()

    answer = asked(once)
    if isinstance(answer, str):
        return answer
    place, calls = _copy(base, folder), []

    def noted(call: Call) -> bool:
        calls.append(phase(call, str(place)))
        return True

    code = watched(lambda: work.run(base, place), str(place), noted)
    return Undisturbed(calls, *answer) if code == 0 else f"the work ended with {code}"


def _killed(folder: Path, name: str, undisturbed: Undisturbed, moment: int) -> tuple[int, str, str]:
    """Run a work, kill it before a call, and check what is left; return the call, its phase, and the problem."""
    work, base = WORKS[name], folder / name.replace(" ", "-")
    load_kernels(undisturbed.kernels)
    place = _copy(base, folder)
    seen, published, labels = 0, max(undisturbed.before, default=0), []

    def allow(call: Call) -> bool:
        nonlocal seen, published
        seen += 1
        if seen > moment:
            labels.append(phase(call, str(place)))
            return False
        file = os.path.basename(call.path)
        if call.name.startswith(("link", "rename")) and os.path.dirname(call.path) == f"{place}/manifest":
            published = max(published, int(file.partition(".")[0]))
        return True

    code = watched(lambda: work.run(base, place), str(place), allow)
    if code not in (0, -signal.SIGKILL):
        return moment, "", f"the work ended with {code}"
    problem = asked(lambda: _checked(work, base, place, undisturbed, published))
    return moment, labels[0] if labels else "", problem


def _checked(work: Work, base: Path, place: Path, undisturbed: Undisturbed, published: int) -> str:
    """Check a store as a kill has left it, run the work again, and check the end; return the problem, if any."""
    problem = _left_by_kill(place, undisturbed, published, work.damaged)
    if problem:
        return f"after the kill: {problem}"
    work.run(base, place)
    end = {name: content for name, content in _end(place).items() if not name.split("/")[-1].startswith(".")}
    problem = _sound(place) or _difference(end, undisturbed.end)
    if problem:
        return f"after the next run: {problem}"
    collect_garbage(place, keep=1)
    left = [path.relative_to(place) for path in place.rglob(".*")]
    return f"no collection of garbage removes {left[0]}" if left else _sound(place)


def _left_by_kill(place: Path, undisturbed: Undisturbed, published: int, damaged: bool) -> str:
    """Return the problem of a store that should show a version; of its report files, each may be old or new.

    Of one that was damaged before, only the version is checked.
    """
    if not published:
        return "a version that was not published" if versions(place) else ""
    found = read_newest(place).version
    if found != published:
        return f"shows version {found}, not {published}"
    if damaged:
        return ""
    states = undisturbed.before if found in undisturbed.before else undisturbed.after
    for name, content in reports(place).items():
        if not name.split("/")[-1].startswith(".") and content not in (
            undisturbed.reports.get(name), undisturbed.end.get(name),
        ):  # fmt: skip
            return f"{name} is neither the old nor the new one"
    return _sound(place) or _difference(contents(open_store(place, at="newest")), states.get(found, {}))


def _sound(place: Path) -> str:
    with open_store(place, at="newest") as store:
        return next((str(finding) for finding in verify(store) if finding.fault), "")


def _difference(found: dict[str, str], expected: dict[str, str]) -> str:
    names = sorted(name for name in found.keys() | expected.keys() if found.get(name) != expected.get(name))
    return f"other content than undisturbed: {', '.join(names[:5])}" if names else ""


def _versions(place: Path) -> dict[int, dict[str, str]]:
    """Return the content of the newest versions of a store, as far as they can still be read."""
    found = {}
    for version in reversed(versions(place)):
        try:
            found[version] = contents(Store(place, read_version(place, version)))
        except KinedexError:
            break
    return found


def _end(place: Path) -> dict[str, str]:
    with open_store(place, at="newest") as store:
        index = current_generation(place, store.manifest) is not None
        return {**contents(store), **reports(place), "index": str(index)}


def _copy(base: Path, folder: Path) -> Path:
    """Copy the store as it is before, if there is one, to the place where this process works."""
    place = folder / f"work-{os.getpid()}" / "store"
    shutil.rmtree(place.parent, ignore_errors=True)
    place.parent.mkdir()
    if (base / "store").exists():
        shutil.copytree(base / "store", place)
    return place
