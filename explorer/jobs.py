"""Jobs: runs of the command line that the page starts, one at a time, with their progress, log and outcome.

`GET /api/jobs` → {jobs: [job]}, the latest last; `GET /api/jobs/ID/log` → {text}; `POST /api/jobs/ID/stop {force?}`. A
job is {id, title, state, stopping, share, done, total, message, command, begun, finished, version, problem}; its state
is waiting, running, done, failed or stopped, and `share` is the fraction that is done, null while that is
unknown. Every change of a job is an event `job`.

Each job is a separate process, so that it outlives the tab. One job runs at a time, and the others wait; if another
process writes to the store, a job waits for it as `--wait` does. A job is stopped as by Ctrl-C: its committed results
remain, and the same command continues. With `force` a job is killed, and results that are not committed are lost. If
the server ends, it stops the running job and drops the waiting ones. The logs are kept in the folder `jobs` of the
store.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, Literal
from weakref import WeakKeyDictionary

from starlette.requests import Request

from kinedex.explorer.answers import NotFoundError, command_line
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.open_archive import Archive
from kinedex.storage.durable_files import write_errors
from kinedex.storage.snapshot.manifest_files import versions

FOLDER = "jobs"
"""The folder of the store with the logs of jobs."""

LOOK_SECONDS = 0.3
"""Seconds from one reading of a job's progress to the next."""

END_SECONDS = 20.0
"""Seconds that a stopped job may take to end; then it is killed, and what it has not committed is lost."""

MAX_LOG_BYTES = 200_000
"""The largest number of bytes that are sent of a log, from its end; the file has the whole log."""

State = Literal["waiting", "running", "done", "failed", "stopped"]


PROGRAM = "kinedex.explorer.warm_process_main"
"""The module that the process runs."""

_MAKING = threading.Lock()


@dataclass
class Job:
    """A job of the explorer: a run of a `kinedex` command.

    Attributes
    ----------
    title : str
        Its name on the page.
    words : tuple of str
        The words of the command after `kinedex`.
    steps : int
        The number of stages, for progress; 0 for a command without stages.
    then : callable, optional
        Called with the job when it is done.
    check : callable, optional
        Called before the job begins. If it raises a KinedexError, the job fails with its message; for instance, because
        the store has changed since the job was planned.
    weights : tuple of float
        Relative durations of its stages, for the progress bar; by default all are equal.
    learns : bool
        True if a process that `Jobs.prepare` has started may run the job.
    """

    title: str
    words: tuple[str, ...]
    steps: int = 0
    then: Callable[[Job], None] | None = None
    check: Callable[[], None] | None = None
    weights: tuple[float, ...] = ()
    learns: bool = False
    id: str = field(default_factory=lambda: uuid.uuid4().hex[:12])
    state: State = "waiting"
    done: int = 0
    part: float | None = None
    message: str = ""
    begun: str | None = None
    finished: str | None = None
    version: int | None = None
    problem: str | None = None
    stopping: bool = False

    def shown(self) -> dict[str, Any]:
        """Return the job as a JSON object for pages."""
        keys = ("id", "title", "state", "stopping", "done", "message", "begun", "finished", "version", "problem")
        part = self.part or 0.0
        weights = self.weights or (1.0,) * self.steps
        done = sum(weights[: self.done]) + part * sum(weights[self.done : self.done + 1])
        share = done / sum(weights) if weights else self.part
        return {key: getattr(self, key) for key in keys} | {
            "total": self.steps,
            "share": share,
            "command": command_line("kinedex", *self.words),
        }


class WarmProcess:
    """The server's handle of a process that waits for a command.

    Parameters
    ----------
    **options : object
        Further arguments of `subprocess.Popen`.
    """

    def __init__(self, **options: Any) -> None:
        words = [sys.executable, "-m", PROGRAM]
        null = subprocess.DEVNULL
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=null, stderr=null, **options)

    @property
    def waits(self) -> bool:
        """True if it can be given a command."""
        return self._process.poll() is None

    def run(self, words: Sequence[str], log: Path) -> subprocess.Popen[bytes] | None:
        """Run a command of `kinedex`, whose output is appended to a file; None if the process has ended meanwhile."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"words": list(words), "log": str(log.absolute())}).encode() + b"\n")
            self._process.stdin.close()
        except OSError:
            return None
        return self._process

    def end(self) -> None:
        """Close the input of the process, which then ends."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:  # it is still importing
            self._process.kill()
            self._process.wait()


class Jobs:
    """The jobs of one server."""

    def __init__(self, archive: Archive) -> None:
        self._path = archive.path
        self._events = archive.events
        self._lock = threading.Condition()
        self._jobs: list[Job] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._spare: WarmProcess | None = None
        self._ended = False
        self._thread: threading.Thread | None = None

    def add(self, job: Job) -> Job:
        """Add a job to the queue, which starts it after all earlier jobs, and return it."""
        with self._lock:
            self._jobs.append(job)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
                self._thread.start()
            self._lock.notify_all()
        self._publish(job)
        return job

    def prepare(self) -> None:
        """Start a process that imports what learning needs, so that the next job that learns begins at once."""
        with self._lock:
            if not self._ended and (self._spare is None or not self._spare.waits):
                self._spare = WarmProcess(**_GROUP)

    def _begin(self, job: Job, out: IO[bytes], words: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start and return the process of a job, or pass the job to the spare process; call this with the lock held."""
        spare = self._spare
        if job.learns and spare is not None and spare.waits:
            self._spare = None
            given = spare.run(words, self.log_file(job))
            if given is not None:
                return given
        command = [sys.executable, "-m", "kinedex", *words]
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, **_GROUP)

    def every(self) -> list[Job]:
        """Return all jobs, oldest first."""
        with self._lock:
            return list(self._jobs)

    def find(self, id: str) -> Job:
        """Return a job by its id."""
        found = next((job for job in self.every() if job.id == id), None)
        if found is None:
            raise NotFoundError(f"no job has the id {id}; jobs are those of this start of the server")
        return found

    def log_file(self, job: Job) -> Path:
        """Return the file of the log of a job."""
        return self._path / FOLDER / f"{job.id}.log"

    def stop(self, job: Job, *, force: bool = False) -> None:
        """Stop a running job as Ctrl-C does, or drop a waiting one; `force` kills a job and its workers at once."""
        with self._lock:
            if job.state == "waiting":
                job.state = "stopped"
            elif job.state == "running":
                job.stopping = True
                if force:
                    self._kill()
                else:
                    self._interrupt()
        self._publish(job)

    def end(self) -> None:
        """Stop the running job, drop the waiting ones, and wait for the end, because the server stops."""
        with self._lock:
            self._ended = True
            for job in self._jobs:
                if job.state == "waiting":
                    job.state = "stopped"
                job.stopping = job.stopping or job.state == "running"
            self._interrupt()
            self._lock.notify_all()
            spare, self._spare = self._spare, None
        if spare is not None:
            spare.end()
        if self._thread is not None:
            self._thread.join(END_SECONDS)
        with self._lock:
            self._kill()

    def _kill(self) -> None:
        """End the running process, and all processes that it has started."""
        if self._process is not None and self._process.poll() is None:
            if os.name == "nt":
                self._process.kill()
            else:
                os.killpg(self._process.pid, signal.SIGKILL)

    def _interrupt(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT if os.name != "nt" else signal.CTRL_BREAK_EVENT)  # type: ignore[attr-defined,unused-ignore]

    def _publish(self, job: Job) -> None:
        self._events.publish("job", job.shown())

    def _work(self) -> None:
        while True:
            with self._lock:
                while not self._ended and all(job.state != "waiting" for job in self._jobs):
                    self._lock.wait()
                if self._ended:
                    return
                job = next(job for job in self._jobs if job.state == "waiting")
                job.state, job.begun, job.message = "running", _now(), "starting"
            self._run(job)
            self._publish(job)

    def _run(self, job: Job) -> None:
        """Run a job until it ends, and record its outcome."""
        log = self.log_file(job)
        code, problem = 1, ""
        try:
            if job.check is not None:
                job.check()
            lines = log.with_suffix(".jsonl")
            with write_errors(log.parent):
                log.parent.mkdir(exist_ok=True)
                log.write_bytes(f"$ {command_line('kinedex', *job.words)}\n".encode())
            with log.open("ab") as out:
                words = [*job.words, "--log-file", str(lines)]
                with self._lock:
                    if job.stopping:
                        raise InterruptedError("stopped before it began")
                    self._process = self._begin(job, out, words)
                code = self._follow(job, self._process, lines)
            lines.unlink(missing_ok=True)
            problem = _problem(log)
            if code == 0 and job.then is not None:
                job.then(job)
        except Exception as fault:  # the thread must go on with the next job
            code, problem = 1, str(fault)
        with suppress(OSError):
            job.version = max(versions(self._path), default=None)  # the store may have been removed meanwhile
        state: State = "done" if code in (0, 3) else "stopped" if job.stopping else "failed"
        job.problem = problem if state == "failed" else None
        job.state = state
        job.finished = _now()  # set last: a reader who sees it sees all other results
        with self._lock:
            self._process = None

    def _follow(self, job: Job, process: subprocess.Popen[bytes], lines: Path) -> int:
        """Publish the progress of a process until it ends, and return its exit code."""
        place = 0
        while True:
            try:
                code: int | None = process.wait(LOOK_SECONDS)
            except subprocess.TimeoutExpired:
                code = None
            place, changed = _progress(job, lines, place)
            if changed or place == 0:
                self._publish(job)
            if code is not None:
                return code


_GROUP: dict[str, Any] = (
    {"start_new_session": True} if os.name != "nt" else {"creationflags": 0x200}  # CREATE_NEW_PROCESS_GROUP
)
"""Options that start a job in a separate group of processes, so that Ctrl-C on the terminal reaches only the server."""


def _progress(job: Job, lines: Path, place: int) -> tuple[int, bool]:
    """Read the log of a job from an offset on, and return the new offset and whether there was anything new."""
    if not lines.is_file():
        return place, False
    with lines.open("rb") as file:
        file.seek(place)
        content = file.read()
    whole = content[: content.rfind(b"\n") + 1]
    changed = False
    for record in _records(whole):
        event = record.get("event")
        if event in ("start", "skip", "progress"):
            job.message, changed = str(record["message"]), True
            job.part = record["done"] / record["total"] if record.get("total") else None
        if event in ("finish", "skip"):
            job.part = None
            job.done, changed = min(job.steps, job.done + 1), True
    return place + len(whole), changed


def _records(content: bytes) -> Iterator[dict[str, Any]]:
    for line in content.splitlines():
        try:
            found = json.loads(line)
        except ValueError:
            continue
        if isinstance(found, dict):
            yield found


def _problem(log: Path) -> str:
    """Return the last lines of a log, which name the problem of a run that failed."""
    text = _tail(log, 4000)
    return "\n".join(text.strip().splitlines()[-6:])


def _tail(path: Path, most: int) -> str:
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - most))
        return file.read().decode("utf-8", "replace")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


_JOBS: WeakKeyDictionary[Archive, Jobs] = WeakKeyDictionary()


def jobs_of(archive: Archive) -> Jobs:
    """Return the `Jobs` of the server of an archive; they are created on the first call."""
    with _MAKING:
        return _JOBS.setdefault(archive, Jobs(archive))


def end_jobs(archive: Archive) -> None:
    """Stop the jobs of an explorer that ends."""
    with _MAKING:
        found = _JOBS.get(archive)
    if found is not None:
        found.end()


def run_command(archive: Archive, pipeline: Path | str, assignments: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the words of the command that runs a pipeline on the store of an explorer."""
    hours = sum(archive.store().take_rows.column("seconds").to_pylist()) / 3600
    executor = "serial" if hours < 1 else "processes"
    settings = [word for one in assignments for word in ("--set", one)]
    return ("run", str(pipeline), "--store", str(archive.path), *settings, "--executor", executor, "--wait", "10m")


class NoRequest(RequestBody):
    """A request whose body is an empty object, {}."""


class StopRequest(RequestBody):
    """The request to stop a job: as Ctrl-C does, or by force."""

    force: bool = False


def list_jobs(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return all jobs of this server."""
    return {"jobs": [job.shown() for job in jobs_of(archive).every()]}


def job_log(archive: Archive, request: Request) -> dict[str, Any]:
    """Return the end of the log of a job."""
    jobs = jobs_of(archive)
    job = jobs.find(request.path_params["job"])
    return {"text": _tail(jobs.log_file(job), MAX_LOG_BYTES), "file": str(jobs.log_file(job))}


def stop_job(archive: Archive, asked: StopRequest, request: Request) -> dict[str, Any]:
    """Stop a job, and return its state as a JSON object."""
    jobs = jobs_of(archive)
    job = jobs.find(request.path_params["job"])
    jobs.stop(job, force=asked.force)
    return job.shown()


routes = [
    get("/api/jobs", list_jobs),
    get("/api/jobs/{job}/log", job_log),
    post("/api/jobs/{job}/stop", stop_job, StopRequest, writes=True),
]
