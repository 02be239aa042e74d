"""Large motion files of every format, and the memory that a process of its own needs to ingest one."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from kinedex.catalog.features import load_feature_set
from kinedex.storage.formats.motion.body_models import BODY
from tests.bodies import STANDING
from tests.bvh_files import bvh_text, dance, mixamo
from tests.pipelines.archives import write_archive

ROOT = Path(__file__).resolve().parents[1]
JOINTS = load_feature_set().joints


def _amc(folder: Path, size: int) -> Path:
    small = write_archive(folder / "small", {"x_aa_1.amc": 40})
    (asf,) = small.rglob("*.asf")
    (folder / "big.asf").write_bytes(asf.read_bytes())
    lines = (small / "x_aa_1.amc").read_bytes().splitlines(keepends=True)
    starts = [at for at, line in enumerate(lines) if line.strip().isdigit()]
    bodies = [b"".join(lines[a + 1 : b]) for a, b in zip(starts, [*starts[1:], len(lines)], strict=True)]
    path = folder / "big.amc"
    with path.open("wb") as file:
        file.write(b"".join(lines[: starts[0]]))
        for number in range(1, 1 + size // (len(bodies[0]) + 7)):
            file.write(b"%d\n" % number + bodies[number % len(bodies)])
    return path


def _bvh(folder: Path, size: int) -> Path:
    root = mixamo()
    head, _, rows = bvh_text(root, dance(root, 40), claimed=0).encode().partition(b"Frame Time: 0.0333333\n")
    times = 1 + size // len(rows)
    path = folder / "big.bvh"
    with path.open("wb") as file:
        file.write(head.replace(b"Frames: 0", b"Frames: %d" % (40 * times)) + b"Frame Time: 0.0333333\n")
        for _ in range(times):
            file.write(rows)
    return path


def _standing(frames: int) -> np.ndarray:
    pose = np.array([STANDING[joint] for joint in JOINTS])
    return pose + np.random.default_rng(0).normal(0, 0.01, (frames, len(JOINTS), 3))


def _csv(folder: Path, size: int) -> Path:
    rows = "".join(",".join(f"{x:.6f}" for x in row) + "\n" for row in _standing(40).reshape(40, -1))
    path = folder / "big.csv"
    with path.open("w") as file:
        file.write(",".join(f"{joint}_{axis}" for joint in JOINTS for axis in "xyz") + "\n")
        for _ in range(1 + size // len(rows)):
            file.write(rows)
    return path


def _trc(folder: Path, size: int) -> Path:
    rows = ["\t".join(f"{x:.6f}" for x in row) + "\n" for row in _standing(40).reshape(40, -1)]
    frames = 1 + size // (len(rows[0]) + 18)
    names = "\t\t\t".join(JOINTS)
    path = folder / "big.trc"
    with path.open("w") as file:
        file.write("PathFileType\t4\t(X/Y/Z)\tbig.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n")
        file.write(f"120\t120\t{frames}\t{len(JOINTS)}\tm\nFrame#\tTime\t{names}\n\n")
        for number in range(frames):
            file.write(f"{number + 1}\t{number / 120:.6f}\t{rows[number % 40]}")
    return path


def _npy(folder: Path, size: int) -> Path:
    from tests.storage.formats.motion.test_amass import rest

    names = (*BODY, "left_hand", "right_hand")
    path = folder / "big.npy"
    positions = np.zeros((1 + size // (12 * len(names)), len(names), 3), np.float32)
    positions[:] = rest(names)
    np.save(path, positions)
    return path


def _npz(folder: Path, size: int) -> Path:
    path = folder / "big.npz"
    positions = np.zeros((1 + size // (24 * len(JOINTS)), len(JOINTS), 3))
    positions[:] = _standing(1)
    np.savez(path, positions=positions, names=np.array(JOINTS))
    return path


def _packed(folder: Path, size: int) -> Path:
    """Make a compressed file that is `size` bytes when it is unpacked."""
    path = folder / "packed.npz"
    positions = np.zeros((1 + size // (24 * len(JOINTS)), len(JOINTS), 3))
    positions[:] = _standing(1)
    np.savez_compressed(path, positions=positions, names=np.array(JOINTS))
    return path


def _amass(folder: Path, size: int) -> Path:
    from tests.storage.formats.motion.test_amass import SMPLH, rest

    np.savez(folder / "model.npz", joints=rest(SMPLH))
    path = folder / "amass.npz"
    frames = 1 + size // (8 * 159)
    poses = np.resize(np.random.default_rng(0).normal(0, 0.2, (40, 156)), (frames, 156))
    poses[:, :3] = [np.pi / 2, 0, 0]
    trans = np.zeros((frames, 3))
    np.savez(path, poses=poses, trans=trans, betas=np.zeros(16), gender="female", mocap_framerate=120.0)
    return path


def _c3d(folder: Path, size: int) -> Path:
    from tests.c3d_files import LABELS, standing_markers, write_c3d

    more = tuple(f"M{i}" for i in range(90))
    frames = 1 + size // (16 * (len(LABELS) + len(more)))
    points = np.concatenate([standing_markers(frames), np.ones((len(more), 3, frames))])
    points[:, 2] %= 1.0
    return write_c3d(folder / "big.c3d", 1000 * points, (*LABELS, *more), Y_SCREEN=["Y"])


WRITERS: dict[str, Callable[[Path, int], Path]] = {
    "amc": _amc, "bvh": _bvh, "c3d": _c3d, "csv": _csv, "trc": _trc, "npy": _npy, "npz": _npz,
    "npz, packed": _packed, "npz, AMASS": _amass,
}  # fmt: skip
"""Format → the function that writes a file of about so many bytes into a folder, and returns its path."""

PROGRAM = """
import json, sys
from pathlib import Path
from tests.large_files import ingest_alone, peak_mb
folder, small, large = map(Path, sys.argv[1:])
ingest_alone(small, folder / "warm")
before = peak_mb()
failure, frames = ingest_alone(large, folder / "store")
print(json.dumps({"before": before, "peak": peak_mb(), "failure": failure, "frames": frames}))
"""


def peak_mb() -> float:
    """Return the peak memory of this process so far, in megabytes."""
    status = Path("/proc/self/status")
    if status.exists():  # `getrusage` would begin with the peak of the process that started this one
        text = status.read_text(encoding="ascii")
        return next(int(line.split()[1]) * 1024 / 1e6 for line in text.splitlines() if line.startswith("VmHWM"))
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def ingest_alone(path: Path, store: Path) -> tuple[str, int]:
    """Ingest one file as a worker does, and return the failure, if there is one, and the frames."""
    from kinedex.catalog.skeletons.mappings import load_mappings
    from kinedex.pipelines.ingestion.file_batches import Batch, Task, read_batch
    from kinedex.storage.formats.motion.reader import ReadSettings
    from kinedex.storage.formats.motion.sources import scan

    feature_set = load_feature_set()
    found = scan(path.parent)
    (motion,) = (one for one in found.motions if one.absolute == path)
    asf = found.skeleton_of(motion) if path.suffix == ".amc" else None
    settings = ReadSettings(rate_hz=120.0, body_model=str(path.parent / "model.npz"))
    task = Task("big", 0, motion, asf, {}, "", ())
    store.mkdir(parents=True, exist_ok=True)
    (store / "frames").mkdir(exist_ok=True)
    mappings = load_mappings("auto", feature_set.joints)
    written = read_batch(Batch(store, feature_set, 30.0, mappings, settings, False, (task,)))
    return "".join(one.message for one in written.failures), written.part.rows if written.part else 0


def measure(folder: Path, form: str, size: int) -> tuple[Path, dict[str, float]]:
    """Write a file of some bytes, ingest it in a new process, and return it with the peak, and that of a small one."""
    (folder / "small").mkdir(parents=True)
    (folder / "large").mkdir()
    small, large = WRITERS[form](folder / "small", 1_000_000), WRITERS[form](folder / "large", size)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), str(small), str(large)],
        cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True, timeout=600,
    )  # fmt: skip
    return large, json.loads(done.stdout.splitlines()[-1])


def estimate_mb(path: Path) -> float:
    """Return the memory that ingest expects to need for a file, in megabytes."""
    from kinedex.pipelines.ingestion.memory_limit import needed_bytes
    from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings

    asf = path.with_suffix(".asf") if path.suffix == ".amc" else None
    settings = ReadSettings(rate_hz=120.0, body_model=str(path.parent / "model.npz"))
    return needed_bytes(MotionFile(path, asf), load_feature_set(), 30.0, settings) / 1e6
