"""Do the work by the command line and the public API: the driver of every commit that has none of its own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from urllib.request import Request, urlopen

import numpy.typing as npt

import kinedex


def read(path: Path) -> object:
    """Read a motion file to its positions and words."""
    take = kinedex.read(path)
    return take.positions, take.words


def features(positions: npt.ArrayLike, orientation: npt.ArrayLike, rate_hz: float) -> object:
    """Compute the features of positions."""
    return kinedex.features(positions, rate_hz, orientation=orientation)


def run_pipeline(pipeline: str | Path, store: Path, source: Path) -> None:
    """Run a pipeline over a folder, in this process."""
    kinedex.run_pipeline(pipeline, store, settings={"source": str(source)})


def search(store: Path, queries: str) -> Callable[[], object]:
    """Return a search of an open store."""
    opened = kinedex.open_store(store)
    return lambda: opened.search(queries)


def rank(store: Path, learned: Path, top: int | None, tau: float) -> Callable[[], object]:
    """Return a ranking of an open store by all templates of another, in one thread."""
    opened, templates = kinedex.open_store(store), _templates(learned)
    return lambda: opened.rank(templates, top, tau=tau, workers=1)


def annotate(store: Path, learned: Path, method: str) -> Callable[[], object]:
    """Return an annotation of an open store by all templates of another."""
    opened, templates = kinedex.open_store(store), _templates(learned)
    return lambda: kinedex.annotate(opened, templates, method)


def _templates(learned: Path) -> list[kinedex.Template]:
    store = kinedex.open_store(learned)
    names = sorted(set(store.templates()["subclass"].to_list()))
    return [store.template(name) for name in names]


def simulate(kind: str, store: Path, folder: Path, options: Sequence[str]) -> None:
    """Make a recording of the longest take of a store."""
    with kinedex.open_store(store) as opened:
        take = opened.takes().sort("frames", "name", descending=[True, False])["name"][0]
    command = [sys.executable, "-m", "kinedex", "simulate", kind, str(store), take, "-o", str(folder), "--seed", "1"]
    subprocess.run([*command, *options], check=True, stdout=subprocess.DEVNULL, timeout=1800)


def track(store: Path, recordings: Path) -> None:
    """Track the recordings of cameras in a folder."""
    kinedex.track(store, recordings / "recordings.yaml")


def reconstruct(store: Path, recordings: Path) -> None:
    """Reconstruct the recordings of a depth camera in a folder."""
    kinedex.reconstruct(store, recordings / "recordings.yaml", direction="forward")


def limb_errors(store: Path, recordings: Path) -> None:
    """Compare takes with the recordings of inertial sensors in a folder."""
    with kinedex.open_store(store) as opened:
        source = opened.takes()["source_root"][0]
    settings = {
        "source": source,
        "recordings": str(recordings / "recordings"),
        "sensors": str(recordings / "sensors.yaml"),
    }
    kinedex.run_pipeline("limb-errors", store, settings)


@contextmanager
def explorer(store: Path) -> Iterator[Callable[[str, object], object]]:
    """Run the explorer's server, and give a function that asks it."""
    command = [sys.executable, "-m", "kinedex", "explore", str(store), "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield _asking(process)
        finally:
            process.terminate()


def _asking(process: subprocess.Popen[str]) -> Callable[[str, object], object]:
    printed = ""
    for line in process.stdout or ():
        printed += line
        if found := re.search(r"(http://[^/\s]+)/\?token=(\S+)", line):
            address, token = found.groups()
            return lambda path, question: _post(address + path, token, question)
    raise RuntimeError(f"kinedex explore printed no address: {printed}")


def _post(address: str, token: str, question: object) -> object:
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    asked = Request(address, json.dumps(question).encode(), headers)
    with urlopen(asked, timeout=60) as answer:
        return json.load(answer)
