"""Power loss: the writes of a traced run, replayed up to every moment with what was not flushed lost or out of order.

A child process commits three versions of a store under `strace`; others upgrade a store, and collect its garbage. The
trace is a list of writes, renames, removals and flushes. For a crash after any of them, a file's content is sure up to
its last flush, and a name is sure once its folder was flushed after it; the rest may be on the disk or not. Of each
moment several such disks are made and opened: the store must show the last version whose commit had returned, or the
one that was being committed, whole.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from kinedex.ops.errors import KinedexError, StoreError
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.attacks.outcome import Options, Outcome

INGEST = """
import sys
from pathlib import Path

import kinedex
from tests.pipelines.archives import write_archive

source, store, acknowledged = (Path(text) for text in sys.argv[1:])
steps = [{"x_1.amc": 60, "x_2.amc": 80}, {"x_3.amc": 70, "x_1.amc": 90}, {"x_4.amc": 50}]
for number, files in enumerate(steps, 1):
    write_archive(source, files, 10 * number)
    kinedex.run_pipeline("ingest", store, settings={"source": str(source)})
    (acknowledged / str(number)).write_text("done")
"""
"""Each step commits takes, builds the index and records both stages; a file tells the trace when it has returned."""

OLD_FORMAT = """
import sys
from pathlib import Path

from tests.storage.stores import unpacked

unpacked(3, Path(sys.argv[2]).parent)
"""

UPGRADE = """
import sys
from pathlib import Path

from kinedex.storage.store.upgrade import upgrade

upgrade(sys.argv[2])
(Path(sys.argv[3]) / "1").write_text("done")
"""

COLLECT = """
import sys
from pathlib import Path

from kinedex.storage.store.garbage_collection import collect_garbage

collect_garbage(sys.argv[2], keep=1)
(Path(sys.argv[3]) / "1").write_text("done")
"""

LABELS = """
import sys
from pathlib import Path

from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.attacks.works import decide

store, acknowledged = Path(sys.argv[2]), Path(sys.argv[3])
feature_set = open_store(store, at="newest").feature_set
for number in range(1, 9):
    decide(store, number)
    (acknowledged / str(number)).write_text("done")
    if number in (3, 6):
        with StoreWriter.open(store, feature_set) as writer:
            writer.commit()
"""
"""Decisions about labels; twice a writer publishes those before, which changes nothing that readers see."""

WORKS = {
    "ingest": ((), INGEST),
    "upgrade": ((OLD_FORMAT,), UPGRADE),
    "gc": ((INGEST,), COLLECT),
    "labels": ((INGEST,), LABELS),
}
"""The programs that make the store, and the program that is traced, of each work."""

SAMPLED, EVERY = ("upgrade",), 10
"""The works of a sample, which crash after each step whose number is a multiple of this."""

CALLS = (
    "open,openat,creat,write,pwrite64,writev,pwritev,lseek,rename,renameat,renameat2,unlink,unlinkat,fsync,fdatasync,"
    "ftruncate,truncate,mkdir,mkdirat,rmdir,link,linkat,fallocate,copy_file_range,sendfile"
)
_LINE = re.compile(r"^(?P<pid>\d+)\s+(?P<rest>.*)$")
_CALL = re.compile(r"^(?P<name>\w+)\((?P<given>.*)\)\s+=\s+(?P<result>-?\d+)(?:<(?P<opened>[^>]*)>)?")
_TEXT = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_DESCRIPTOR = re.compile(r"^(?:(\d+)|AT_FDCWD)(?:<((?:\\x[0-9a-f]{2})*)>)?")


@dataclass(frozen=True)
class Step:
    """One traced call on a file of the store: its kind, the path, and what it did."""

    kind: str
    path: str
    other: str = ""
    offset: int = 0
    data: bytes = b""


@dataclass
class Inode:
    """The content of a file that is sure to be on the disk, and what has been written since its last flush."""

    flushed: bytes = b""
    pending: list[Step] = field(default_factory=list)


class Trace:
    """Reads the lines of `strace -f -y -xx` into steps."""

    def __init__(self, root: Path) -> None:
        self._root = str(root)
        self._offsets: dict[tuple[str, str], int] = {}
        self._unfinished: dict[str, str] = {}
        self.unknown: set[str] = set()

    def steps(self, text: str) -> Iterator[Step]:
        """Yield the steps of a trace in order."""
        for line in text.splitlines():
            found = _LINE.match(line)
            if found is None:
                continue
            pid, rest = found["pid"], found["rest"]
            if rest.endswith("<unfinished ...>"):
                self._unfinished[pid] = rest.removesuffix("<unfinished ...>")
                continue
            if rest.startswith("<... "):
                rest = self._unfinished.pop(pid, "") + rest.partition("resumed>")[2]
            call = _CALL.match(rest)
            if call is not None and int(call["result"]) >= 0:
                yield from self._step(call["name"], call["given"], int(call["result"]), call["opened"] or "")

    def _step(self, name: str, given: str, result: int, opened: str) -> Iterator[Step]:
        paths = [_decoded(text) for text in _TEXT.findall(given)]
        if name in ("open", "openat", "creat"):
            path = _decoded(opened)
            self._offsets[str(result), path] = 0
            if self._inside(path) and ("O_CREAT" in given or name == "creat"):
                yield Step("open", path, data=b"new" if "O_TRUNC" in given or name == "creat" else b"")
            return
        if name in ("rename", "renameat", "renameat2", "link", "linkat"):
            if self._inside(paths[0]) or self._inside(paths[1]):
                yield Step("link" if name.startswith("link") else "rename", paths[0], paths[1])
        elif name in ("unlink", "unlinkat", "rmdir", "mkdir", "mkdirat"):
            folder = _DESCRIPTOR.match(given) if name.endswith("at") else None
            path = os.path.join(_decoded(folder[2] or ""), paths[0]) if folder else paths[0]
            if self._inside(path):
                kind = "rmdir" if name == "rmdir" or "AT_REMOVEDIR" in given else name.removesuffix("at")
                yield Step(kind, path)
        elif name == "truncate":
            if self._inside(paths[0]):
                yield Step("truncate", paths[0], offset=int(given.rsplit(",", 1)[1]))
        else:
            yield from self._on_descriptor(name, given, result)

    def _on_descriptor(self, name: str, given: str, result: int) -> Iterator[Step]:
        descriptor = _DESCRIPTOR.match(given)
        if descriptor is None or descriptor[1] is None:
            return
        path = _decoded(descriptor[2] or "").removesuffix(" (deleted)")
        place = descriptor[1], path
        if not self._inside(path):
            return
        if name in ("fsync", "fdatasync"):
            yield Step("flush", path)
        elif name == "lseek":
            self._offsets[place] = result
        elif name == "ftruncate":
            yield Step("truncate", path, offset=int(given.rsplit(",", 1)[1]))
        elif name == "pwrite64":
            data = _bytes(given)[:result]
            yield Step("write", path, offset=int(given.rsplit(",", 1)[1]), data=data)
        elif name in ("write", "writev"):
            at = self._offsets.get(place, 0)
            yield Step("write", path, offset=at, data=_bytes(given)[:result])
            self._offsets[place] = at + result
        elif name != "fallocate":
            self.unknown.add(name)

    def _inside(self, path: str) -> bool:
        return path == self._root or path.startswith(self._root + os.sep)


def _decoded(text: str) -> str:
    return os.fsdecode(bytes.fromhex(text.replace("\\x", ""))) if "\\x" in text else text


def _bytes(given: str) -> bytes:
    return b"".join(bytes.fromhex(text.replace("\\x", "")) for text in _TEXT.findall(given))


class Disk:
    """A model of a disk: the content that is certainly on it, and the content that may be on it as well."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.folders: set[str] = set()
        self.sure = {path: Inode(content) for path, content in files.items()}
        self.now = dict(self.sure)
        self.pending: list[Step] = []
        self._made: dict[int, Inode] = {}

    def apply(self, step: Step) -> None:
        """Carry out a step."""
        if step.kind == "write" or step.kind == "truncate":
            if step.path in self.now:
                self.now[step.path].pending.append(step)
        elif step.kind == "flush":
            self._flush(step.path)
        elif step.kind == "open":
            if step.path not in self.now:
                self._entry(step)
            elif step.data:
                self.now[step.path].pending.append(Step("truncate", step.path))
        else:
            self._entry(step)

    def _entry(self, step: Step) -> None:
        self.pending.append(step)
        if step.kind == "open":
            self._made[id(step)] = self.now[step.path] = Inode()
        elif step.kind == "link":
            self._made[id(step)] = self.now[step.other] = self.now[step.path]
        else:
            _change(self.now, self.folders, step, {})

    def _flush(self, path: str) -> None:
        if path in self.now:
            inode = self.now[path]
            inode.flushed, inode.pending = _written(inode.flushed, inode.pending), []
            return
        left = []
        for step in self.pending:  # a flushed folder has the entries that were made in it
            if os.path.dirname(step.other or step.path) == path:
                _change(self.sure, set(), step, self._made)
            else:
                left.append(step)
        self.pending = left

    def states(self, chance: random.Random, several: int) -> Iterator[dict[str, bytes]]:
        """Yield files as a crash may leave them: nothing unflushed, all of it, names without content, and mixtures."""
        for share_names, share_data in (
            (0.0, 0.0),
            (1.0, 1.0),
            (1.0, 0.0),
            *[(chance.random(), chance.random())] * several,
        ):
            names = dict(self.sure)
            for step in self.pending:
                if chance.random() < share_names:
                    _change(names, set(), step, self._made)
            yield {path: self._content(inode, share_data, chance) for path, inode in names.items()}

    def _content(self, inode: Inode, share: float, chance: random.Random) -> bytes:
        kept = [step for step in inode.pending if chance.random() < share]
        return _written(inode.flushed, kept)


def _change(names: dict[str, Inode], folders: set[str], step: Step, made: dict[int, Inode]) -> None:
    if step.kind == "open":
        names[step.path] = made[id(step)]
    elif step.kind == "mkdir":
        folders.add(step.path)
    elif step.kind == "unlink":
        names.pop(step.path, None)
    elif step.kind == "link":
        names[step.other] = made[id(step)]
    elif step.kind == "rename":
        moved = {path: inode for path, inode in names.items() if _under(path, step.path)}
        for path in moved:
            del names[path]
        names.update({step.other + path.removeprefix(step.path): inode for path, inode in moved.items()})


def _under(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder + os.sep)


def _written(content: bytes, steps: list[Step]) -> bytes:
    whole = bytearray(content)
    for step in steps:
        if step.kind == "truncate":
            del whole[step.offset :]
            whole.extend(bytes(step.offset - len(whole)))
        else:
            whole.extend(bytes(max(0, step.offset - len(whole))))
            whole[step.offset : step.offset + len(step.data)] = step.data
    return bytes(whole)


def contents(path: Path) -> tuple[tuple[str, str], ...]:
    """Return the names of the takes of a store, each with its words, and the ids of its labels."""
    with open_store(path, at="newest") as store:
        rows = store.takes().select("name", "take_id").sort("name").rows()
        labels = (("label", str(one)) for one in store.labels().column("id").to_pylist())
        return (*((name, store.words([number]).take(0).tobytes().hex()) for name, number in rows), *labels)


@dataclass(frozen=True)
class Traced:
    """The traced program of a work.

    Attributes
    ----------
    files : dict of str to bytes
        The files of the store as they were before.
    steps : list of Step
        The writing calls.
    store : Path
        The store.
    acknowledged : Path
        The folder into which the program writes a file after each commit.
    """

    files: dict[str, bytes]
    steps: list[Step]
    store: Path
    acknowledged: Path


def traced(folder: Path, work: str) -> Traced:
    """Make the store of a work, and run its program under strace."""
    source, store, acknowledged = folder / "source", folder / "store", folder / "acknowledged"
    before, program = WORKS[work]
    for child in before:
        acknowledged.mkdir(exist_ok=True)
        _run([sys.executable, "-c", child, *map(str, (source, store, acknowledged))])
    shutil.rmtree(acknowledged, ignore_errors=True)
    acknowledged.mkdir()
    files = {str(path): path.read_bytes() for path in store.rglob("*") if path.is_file()}
    log = folder / "trace"
    command = ["strace", "-f", "-y", "-xx", "-s", "100000000", "-e", f"trace={CALLS}", "-o", str(log)]
    _run([*command, sys.executable, "-c", program, *map(str, (source, store, acknowledged))])
    trace = Trace(folder)
    steps = [step for step in trace.steps(log.read_text()) if not _under(step.path, str(source))]
    if trace.unknown:
        raise AssertionError(f"calls that the model does not know: {sorted(trace.unknown)}")
    return Traced(files, steps, store, acknowledged)


def _run(command: list[str]) -> None:
    subprocess.run(command, check=True, timeout=300, stdout=subprocess.DEVNULL)


def run(folder: Path, options: Options) -> Outcome:
    """Crash after every step of each traced work, and of each moment open what the disk may hold."""
    if shutil.which("strace") is None:
        return Outcome({"skipped, there is no strace on this machine": 1})
    total = Outcome({"crash points": 0, "disks": 0, "before": 0, "after": 0})
    chosen, _, step = (options.case or "").partition(":")
    sample = options.size == "sample" and options.case is None
    for work in SAMPLED if sample else WORKS:
        if chosen not in ("", work):
            continue
        (folder / work).mkdir()
        only = int(step) if step else None
        several = 6 if options.size == "nightly" else 1
        outcome = attack(folder / work, work, options.seed, several, every=EVERY if sample else 1, only=only)
        for kind, number in outcome.counts.items():
            total.count(kind, number)
            total.count(f"{work}: {kind}", number)
        total.failures += outcome.failures
    total.cases = total.counts["disks"]
    return total


def attack(
    folder: Path, work: str = "ingest", seed: int = 0, several: int = 1, every: int = 1, only: int | None = None
) -> Outcome:
    """Crash after every step of a traced work, or every so many of them, and open what each disk may hold.

    Parameters
    ----------
    folder : Path
        An empty folder to work in.
    work : str
        One of `WORKS`.
    seed : int
        Seed of the mixtures.
    several : int
        Mixtures of each moment, besides nothing, everything, and names without content.
    every : int
        Crash after each step whose number is a multiple of this.
    only : int or None
        Crash after the step of this number alone.

    Returns
    -------
    Outcome
        The counts of crash points and disks, and of the disks by the state of the store; a failure for every disk on
        which it was torn.
    """
    trace = traced(folder, work)
    after = [*_versions(folder, trace)]
    disk, outcome, done = Disk(trace.files), Outcome({"crash points": 0, "disks": 0, "before": 0, "after": 0}), 0
    tried: dict[int, str] = {}
    for number, step in enumerate(trace.steps):
        if _under(step.path, str(trace.acknowledged)):
            done = max(done, int(Path(step.path).name))
            continue
        disk.apply(step)
        if number % every or only not in (None, number):
            continue
        outcome.count("crash points")
        for files in disk.states(random.Random(f"{seed}/{number}"), several):
            inside = {path: content for path, content in files.items() if _under(path, str(trace.store))}
            key = hash((done, frozenset(inside.items())))
            if key not in tried:
                tried[key] = _opened(folder / "crashed", trace.store, inside, after[done : done + 2])
                outcome.count("disks")
                if tried[key] in ("before", "after"):
                    outcome.count(tried[key])
                else:
                    problem = f"{work}, after step {number} ({step.kind} {step.path}): {tried[key]}"
                    outcome.fail(f"{work}:{number}", problem)
    return outcome


def _versions(folder: Path, trace: Traced) -> Iterator[object]:
    """Yield what the store holds before the first commit and after each acknowledged one."""
    disk, seen = Disk(trace.files), 0
    yield contents(_laid_out(folder / "whole", trace.store, trace.files)) if trace.files else ()
    for step in trace.steps:
        if _under(step.path, str(trace.acknowledged)):
            if int(Path(step.path).name) > seen:
                seen = int(Path(step.path).name)
                names = {path: _written(inode.flushed, inode.pending) for path, inode in disk.now.items()}
                yield contents(_laid_out(folder / "whole", trace.store, names))
            continue
        disk.apply(step)


def _laid_out(place: Path, store: Path, files: dict[str, bytes]) -> Path:
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for path, content in files.items():
        if _under(path, str(store)):
            file = place / Path(path).relative_to(store)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    return place


def _opened(place: Path, store: Path, files: dict[str, bytes], expected: list[object]) -> str:
    """Open a store as a crash has left it: "before" or "after" the commit that was on its way, or what is wrong."""
    _laid_out(place, store, files)
    try:
        found: object = contents(place)
        with open_store(place, at="newest") as opened:
            damage = [str(finding) for finding in verify(opened) if finding.fault]
    except StoreError as fault:
        found, damage = (), [] if not expected[0] else [f"cannot be opened: {fault}"]
    except KinedexError as fault:
        return f"fails: {fault}"
    if damage:
        return damage[0]
    if found == expected[0]:
        return "before"
    return "after" if found in expected[1:] else "takes of neither version"
