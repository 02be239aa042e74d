"""Keep damaged files that cannot be restored in a quarantine, with a list of what they contained."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from kinedex.storage.durable_files import TEMPORARY, names_in, sync_folder, write_errors, write_flushed

FOLDER = "quarantine"
JOURNAL = "journal"
"""The folder whose files are modified in place."""

LIST = "quarantine.json"
"""The name of the list file in a quarantine's folder."""


@dataclass(frozen=True)
class KeptFile:
    """A file in a quarantine.

    Attributes
    ----------
    file : str
        Path relative to the store, with /; the quarantine keeps it under the same path.
    why : str
        The damage.
    held : str
        Description of its content.
    sha256 : str
        The expected checksum; empty if none is recorded.
    stage : str
        For results, the stage that made them, "<pipeline>/<stage>".
    """

    file: str
    why: str
    held: str
    sha256: str = ""
    stage: str = ""


@dataclass(frozen=True)
class LostTake:
    """A take that the store lost, as far as its row is known.

    Attributes
    ----------
    name : str
        Its name; empty if its row could not be read.
    take_id : int
        Its id.
    source : str
        The absolute path of its source file.
    why : str
        The reason.
    """

    name: str
    take_id: int
    source: str
    why: str


@dataclass
class PendingRun:
    """A pipeline that must run again, because results of its stages were removed.

    Attributes
    ----------
    stages : list of str
        The stages whose results were removed, "<pipeline>/<stage>".
    file : str
        The pipeline file, relative to the store.
    done : bool
        True once it has run.
    """

    stages: list[str]
    file: str
    done: bool = False

    def command(self, store: Path) -> tuple[str, ...]:
        """Return the command that runs the pipeline."""
        return ("kinedex", "run", str(store / self.file), "--store", str(store))


@dataclass
class Quarantine:
    """The quarantine of one repair, in `quarantine/<time>/`; the folder is created with the first entry.

    Attributes
    ----------
    store : Path
        The store's directory.
    name : str
        Name of the folder, a time in UTC.
    files : list of KeptFile
        The files that it keeps.
    takes : list of LostTake
        The takes that were lost.
    runs : list of PendingRun
        The pipelines that must run again.
    """

    store: Path
    name: str
    files: list[KeptFile] = field(default_factory=list)
    takes: list[LostTake] = field(default_factory=list)
    runs: list[PendingRun] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        """The folder of this quarantine."""
        return self.store / FOLDER / self.name

    @classmethod
    def new(cls, store: Path) -> Quarantine:
        """Return a quarantine with a new name, without writing anything."""
        name = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        number = 2
        while (store / FOLDER / name).exists():
            name = f"{name.split('-')[0]}-{number}"
            number += 1
        return cls(store, name)

    def keep(self, entry: KeptFile) -> None:
        """Add a file to the list and copy its content if it exists; the original file is not removed."""
        self.files.append(entry)
        source, target = self.store / entry.file, self.folder / entry.file
        with write_errors(target):
            if source.is_file():
                target.parent.mkdir(parents=True, exist_ok=True)
                _preserve(source, target)
                sync_folder(target.parent)
        self.write()

    def finish(self, run: PendingRun) -> None:
        """Record that a pipeline has run again, and remove the kept files of its stages."""
        run.done = True
        self.write()
        made = [entry for entry in self.files if entry.stage in run.stages]
        for entry in made:
            (self.folder / entry.file).unlink(missing_ok=True)
        self.files = [entry for entry in self.files if entry not in made]
        self.write()
        if not self.files and not self.takes and all(one.done for one in self.runs):
            shutil.rmtree(self.folder)

    def write_file(self, name: str, text: str) -> str:
        """Write an additional file into the quarantine, and return its path relative to the store."""
        path = self.folder / name
        with write_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = path.with_name(f"{TEMPORARY}{path.name}")
            write_flushed(temporary, text)
            os.replace(temporary, path)
            sync_folder(path.parent)
        return path.relative_to(self.store).as_posix()

    def write(self) -> None:
        """Write the list of this quarantine."""
        document = {
            "files": [asdict(entry) for entry in self.files],
            "takes": [asdict(entry) for entry in self.takes],
            "runs": [asdict(entry) for entry in self.runs],
        }
        self.write_file(LIST, json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def quarantines(store: Path) -> list[Quarantine]:
    """Return the quarantines of a store, oldest first; one with an unreadable list has no entries."""
    folder = store / FOLDER
    return [_read(store, name) for name in names_in(folder) if (folder / name).is_dir()]


def _read(store: Path, name: str) -> Quarantine:
    try:
        document = json.loads((store / FOLDER / name / LIST).read_text(encoding="utf-8"))
        return Quarantine(
            store,
            name,
            [KeptFile(**entry) for entry in document["files"]],
            [LostTake(**entry) for entry in document["takes"]],
            [PendingRun(**entry) for entry in document["runs"]],
        )
    except (OSError, ValueError, KeyError, TypeError):
        return Quarantine(store, name)


def _preserve(source: Path, target: Path) -> None:
    """Preserve a file's content under another path, by a hard link, or by a copy if it can change or links fail."""
    target.unlink(missing_ok=True)
    if source.parent.name == JOURNAL:
        shutil.copy2(source, target)
        return
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
