"""Targets of the fuzzer: every reader with small valid files, their mutations, and conditions on its results."""

from __future__ import annotations

import atexit
import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from kinedex.catalog.classes import load_classes
from kinedex.catalog.configs import config_names, config_path, load_yaml
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.query_reader import parse_queries, read_queries
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.catalog.skeletons.mappings import load_skeleton
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.ingestion.analysis import analyse, unknown_feature_warnings
from kinedex.pipelines.ingestion.metadata import load_metadata
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.formats.motion.body_models import load_body_model
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.mapped_body import FARTHEST_M
from kinedex.storage.formats.motion.opensim import OpenSimReader
from kinedex.storage.formats.motion.positions import is_positions_csv
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body, reader_of
from kinedex.storage.snapshot.schemas import COLUMN_TYPES
from tests.bodies import STANDING
from tests.fuzz import camera_files, depth_files, imu_files, packed_files, seeds
from tests.fuzz.binary import C3D, FBX, GLB, NPY, NPZ
from tests.fuzz.mutations import ANY, TEXT, Mutation, insert_word, nest
from tests.fuzz.words import (
    AMC_WORDS,
    ASF_WORDS,
    BVH_WORDS,
    CSV_WORDS,
    DEEP_BVH,
    DEEP_EAF,
    DEEP_FBX,
    DEEP_MVNX,
    DEEP_YAML,
    EAF_WORDS,
    FBX_WORDS,
    GLTF_WORDS,
    JSON_WORDS,
    KEYPOINT_WORDS,
    MOT_WORDS,
    MOTIVE_WORDS,
    MVNX_WORDS,
    NEXUS_WORDS,
    OSIM_WORDS,
    QUALISYS_WORDS,
    VTT_WORDS,
    YAML_WORDS,
)


class Broken(AssertionError):
    """A reader returned something that must not come out of any file, or an error that helps nobody."""


@dataclass(frozen=True)
class Target:
    """One reader: its files' ending, seeds by name (all valid), the mutations, and the check that reads a file.

    Children are given it, so its functions can be pickled.

    check: reads a file and raises `Broken` for a result that must not be; the errors that it may raise are `refusals`.
    largest: mutants have no more bytes than this, so that what costs time is the reader's doing.
    """

    name: str
    ending: str
    seeds: Callable[[], dict[str, bytes]]
    mutations: tuple[Mutation, ...]
    check: Callable[[Path], None]
    refusals: tuple[type[Exception], ...] = (SourceError,)
    largest: int = 1 << 20

    def read(self, path: Path) -> bool:
        """Read a file; return False where the reader refuses it with an error of kinedex.

        Raises
        ------
        Broken: a wrong result or an unhelpful error. Any other exception is a defect, too.
        """
        try:
            self.check(path)
        except self.refusals as fault:
            _check_refusal(path, fault)
            return False
        return True


def _check_refusal(path: Path, fault: Exception) -> None:
    message, line = str(fault), getattr(fault, "line", None)
    text = path.read_bytes()
    lines = len(text.decode("latin-1").splitlines()) + text.count(b"\xe2\x80\xa8") + text.count(b"\xe2\x80\xa9")
    if line is not None and not 1 <= line <= lines + 1:
        raise Broken(f"line {line} of a file of {lines} lines: {message[:300]}")
    if len(message) > 3000:
        raise Broken(f"a message of {len(message)} characters: {message[:300]}…")
    try:
        message.encode()
    except UnicodeEncodeError:
        raise Broken(f"a message that cannot be written as UTF-8: {message[:300]!r}") from None


# ---- motion ----------------------------------------------------------------------------------------------


def check_motion(path: Path, asf: Path | None = None, given: ReadSettings = ReadSettings(30.0, None, 5)) -> None:  # noqa: B008
    """Read a motion file as an ingest does; what comes out must be finite, within bounds, and fit to be written."""
    feature_set, mappings = seeds.known()
    check_body(read_body(path, asf, mappings, feature_set.joints, given))


def check_body(body: Body) -> None:
    """Check a body as an ingest uses it."""
    feature_set, _ = seeds.known()
    known = np.array([joint not in body.unknown for joint in feature_set.joints])
    positions = body.positions[known]
    if body.valid is not None:
        positions = positions[:, :, body.valid]
    if not (np.abs(positions) <= 1.01 * FARTHEST_M).all():
        raise Broken("a position that is not finite, or out of bounds")
    rotations = np.linalg.norm(body.orientation, axis=0)
    if not (np.isnan(rotations) | (np.abs(rotations - 1.0) < 1e-6)).all():
        raise Broken("a turn that is no unit quaternion")
    if not SLOWEST_HZ <= body.rate_hz <= FASTEST_HZ or not body.frames:
        raise Broken(f"{body.frames} frames at {body.rate_hz} Hz")
    rows, _, words = analyse(body, feature_set, 30.0)
    if rows.shape[2] != len(words) or not 1 <= len(words) <= 30 * body.frames / body.rate_hz + 2:
        raise Broken(f"{body.frames} frames at {body.rate_hz} Hz became {len(words)}")
    "\n".join([body.unit, body.skeleton, *body.warnings, *unknown_feature_warnings(feature_set, body)]).encode()


def check_persons(path: Path) -> None:
    """Read every person of a file, the first three at most."""
    feature_set, mappings = seeds.known()
    reader = reader_of(path)
    for person in reader.persons(MotionFile(path), mappings)[:3] or ("",):
        file, given = MotionFile(path, person=person), ReadSettings(30.0, None, 5)
        check_body(reader.read(file, mappings, feature_set.joints, given))


def _beside(path: Path, ending: str, which: int) -> Path:
    """The valid other half of an Acclaim pair, beside the mutated one: the one that its first bytes point to."""
    texts = [pair[which] for pair in seeds.pairs().values()]
    other = path.with_name(f"{path.stem}-valid{ending}")
    data = path.read_bytes()
    scores = [_alike(data, pair[1 - which]) for pair in seeds.pairs().values()]
    other.write_bytes(texts[int(np.argmax(scores))])
    return other


def _alike(data: bytes, text: bytes) -> int:
    words = set(text[:4000].split())
    return sum(word in words for word in data[:4000].split())


def check_asf(path: Path) -> None:
    """A mutated skeleton with a valid motion."""
    other = _beside(path, ".amc", 1)
    try:
        check_motion(other, path)
    finally:
        other.unlink()


def check_amc(path: Path) -> None:
    """A mutated motion with its valid skeleton."""
    other = _beside(path, ".asf", 0)
    try:
        check_motion(path, other)
    finally:
        other.unlink()


def check_strange_bvh(path: Path) -> None:
    """The parser alone, whatever the joints are called."""
    bvh = parse_bvh(path)
    if not np.isfinite(bvh.channels).all() or not SLOWEST_HZ <= bvh.rate_hz <= FASTEST_HZ:
        raise Broken("channels that are not finite, or a rate out of bounds")
    if len(bvh.indices) + len(bvh.redundant) != len(bvh.nodes):
        raise Broken("two nodes of one name")


def check_strange_c3d(path: Path) -> None:
    """The parser alone, whatever the markers are called."""
    markers = parse_c3d(path)
    possible = markers.rate_hz is None or SLOWEST_HZ <= markers.rate_hz <= FASTEST_HZ
    if np.isinf(markers.positions).any() or not possible:
        raise Broken("markers infinitely far away, or a rate out of bounds")
    if markers.positions.shape[:2] != (len(markers.names), 3) or len(set(markers.names)) != len(markers.names):
        raise Broken(f"{markers.positions.shape[:2]} points, named {markers.names}")


def check_amass(path: Path) -> None:
    """Joint angles with a body model; what has positions after a mutation is read as such."""
    check_motion(path, given=ReadSettings(30.0, None, 5, str(_body_model())))


@lru_cache(maxsize=1)
def _body_model() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="kinedex-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    model = folder / "model.npz"
    model.write_bytes(seeds.body_model())
    return model


def check_body_model(path: Path) -> None:
    """A mutated body model: joints that a figure of some shape can be made of."""
    model = load_body_model(str(path), "neutral")
    if not np.isfinite(model.rest(np.ones(16))).all() or not all(a < i for i, a in enumerate(model.parents)):
        raise Broken("places that are no numbers, or a joint before its parent")


def check_opensim_motion(path: Path) -> None:
    """A mutated motion with a valid model."""
    _check_opensim(path, _model_beside())


def check_opensim_model(path: Path) -> None:
    """A mutated model with a valid motion."""
    motion = path.with_suffix(".mot")
    motion.write_bytes(seeds.opensim_motion()["degrees"])
    try:
        _check_opensim(motion, path)
    finally:
        motion.unlink()


def _check_opensim(motion: Path, model: Path) -> None:
    points = OpenSimReader().points(MotionFile(motion), ReadSettings(body_model=str(model)))
    if not SLOWEST_HZ <= (points.rate_hz or 0.0) <= FASTEST_HZ or len(set(points.names)) != len(points.positions):
        raise Broken(f"{len(points.names)} names of {len(points.positions)} points at {points.rate_hz} Hz")


@lru_cache(maxsize=1)
def _model_beside() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="kinedex-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    model = folder / "model.osim"
    model.write_bytes(seeds.opensim_model()["version-4"])
    return model


def check_csv(path: Path) -> None:
    """Recognise a table of positions, and check the motion that is read from it."""
    if is_positions_csv(path):
        check_motion(path)


# ---- tables and configuration ----------------------------------------------------------------------------


def check_metadata(path: Path) -> None:
    """Join a table to takes; the values are those of columns that a store can declare."""
    metadata = load_metadata([str(path)])
    columns, _ = metadata.columns({})
    takes = [{"take_id": n, "name": f"t{n}", "source": f"a/t{n}.bvh"} for n in range(3)]
    values = metadata.join(takes, "/archive", columns).values
    for name, column in columns.items():
        pa.array([row.get(name) for row in values.values()], COLUMN_TYPES[column.type])


def check_ground_truth(path: Path) -> None:
    """Segments are ranges of frames with names."""
    found = read_labels(path)
    if not {segment.take for segment in found.segments} <= set(found.takes) or not all(found.takes):
        raise Broken(f"{found.takes}")
    for segment in found.segments:
        start, stop = segment.source_frames(FASTEST_HZ)
        whole = segment.in_seconds or (start, stop) == (segment.start, segment.stop)
        if not 0 <= segment.start < segment.stop < 10**15 or not start <= stop or not whole:
            raise Broken(f"{segment}")
        if not segment.take or not segment.label:
            raise Broken(f"{segment}")
        segment.error(segment.where)
        f"{segment.take}{segment.label}".encode()


def check_queries(path: Path) -> None:
    """Queries can be written, and read back as they are."""
    feature_set, _ = seeds.known()
    queries = read_queries(path, feature_set)
    if parse_queries(write_queries(queries, feature_set), feature_set) != queries:
        raise Broken("queries that do not read back as they are written")


def check_skeleton(path: Path) -> None:
    """A mapping can be laid over a skeleton."""
    feature_set, _ = seeds.known()
    mapping = load_skeleton(path, feature_set.joints)
    if not np.isfinite(mapping.axes).all() or (mapping.unit_m is not None and not 0 < mapping.unit_m < np.inf):
        raise Broken("axes or a unit that are none")
    mapping.fit({f"mixamorig:{name}": i for i, name in enumerate(STANDING)})


def check_pipeline(path: Path) -> None:
    """A pipeline's stages have checked parameters."""
    settings = load_yaml(path).mapping().get("settings")
    needed = [str(name) for name, value in settings.items() if value is None] if isinstance(settings, dict) else []
    for stage in load_pipeline(path, dict.fromkeys(needed, "somewhere")).stages:
        stage.params.model_dump_json()


def check_features(path: Path) -> None:
    """A feature set can be used: every feature has a bit in one of its sets."""
    feature_set = load_feature_set(path)
    feature_set.without(feature_set.joints[:1])


def check_classes(path: Path) -> None:
    """Classes can be looked up."""
    load_classes(path, _subclasses())


@lru_cache(maxsize=1)
def _subclasses() -> list[str]:
    """A subclass for every pattern of the shipped class files."""
    texts = [config_path("classes", name).read_text(encoding="utf-8") for name in config_names("classes")]
    return sorted({word.replace("*", "") for text in texts for word in re.findall(r"[A-Za-z0-9*]{3,}", text)})


def _text(words: tuple[bytes, ...] = (), pairs: tuple[tuple[bytes, bytes], ...] = ()) -> tuple[Mutation, ...]:
    """The mutations of a text format: those of any, its own words put somewhere, and what it nests."""
    own: tuple[Mutation, ...] = (*ANY, *TEXT, *TEXT)
    if words:
        own += (partial(insert_word, words=words),) * 2
    if pairs:
        own += (partial(nest, pairs=pairs),)
    return own


_YAML = _text(YAML_WORDS, DEEP_YAML)

_WORDS = _text(camera_files.CALIBRATION_WORDS, DEEP_YAML)
_CAMERAS = (
    Target("calibration-yaml", ".yaml", camera_files.yaml_calibrations, _WORDS, camera_files.check_calibration,
           (KinedexError,), 60_000),
    Target("calibration-easymocap", ".yml", camera_files.easymocap_calibrations, _WORDS, camera_files.check_calibration,
           (KinedexError,), 60_000),
    Target("calibration-json", ".json", camera_files.json_calibrations, _WORDS, camera_files.check_calibration,
           (KinedexError,)),
    Target("calibration-toml", ".toml", camera_files.toml_calibrations, _WORDS, camera_files.check_calibration,
           (KinedexError,)),
    Target("openpose", ".json", camera_files.openpose_frames, _text(KEYPOINT_WORDS, DEEP_YAML),
           camera_files.check_openpose),
    Target("mmpose", ".json", camera_files.mmpose_files, _text((*KEYPOINT_WORDS, b'"frame_id":1,'), DEEP_YAML),
           camera_files.check_mmpose),
    Target("coco-results", ".json", camera_files.coco_results, _text(KEYPOINT_WORDS, DEEP_YAML),
           camera_files.check_coco_results),
    Target("keypoint-csv", ".csv", camera_files.csv_tables, _text(camera_files.TABLE_WORDS),
           camera_files.check_keypoint_table),
    Target("keypoint-parquet", ".parquet", camera_files.parquet_tables, ANY, camera_files.check_keypoint_table),
    Target("mask-png", ".png", camera_files.png_masks, ANY, camera_files.check_mask),
    Target("mask-npz", ".npz", camera_files.packed_masks, (*ANY, *NPZ, *NPZ), camera_files.check_packed_masks),
    Target("recordings", ".yaml", camera_files.recordings, _YAML, camera_files.check_recordings, (KinedexError,),
           60_000),
)  # fmt: skip
"""The readers of camera recordings."""

_LENSES = _text(depth_files.CAMERA_WORDS, DEEP_YAML)
_DEPTH = (
    Target("depth-png", ".png", depth_files.png_images, ANY, depth_files.check_png),
    Target("depth-npz", ".npz", depth_files.npz_images, (*ANY, *NPZ, *NPZ), depth_files.check_npz, (KinedexError,)),
    Target("depth-raw", ".raw", depth_files.raw_images, ANY, depth_files.check_raw),
    Target("pcd", ".pcd", depth_files.pcd_clouds, _text(depth_files.PCD_WORDS), depth_files.check_pcd),
    Target("ply", ".ply", depth_files.ply_clouds, _text(depth_files.PLY_WORDS), depth_files.check_ply),
    Target("depth-camera-yaml", ".yaml", depth_files.yaml_cameras, _LENSES, depth_files.check_camera, (KinedexError,),
           60_000),
    Target("depth-camera-json", ".json", depth_files.json_cameras, _LENSES, depth_files.check_camera, (KinedexError,)),
    Target("depth-camera-text", ".txt", depth_files.text_cameras, _text(), depth_files.check_camera, (KinedexError,)),
    Target("depth-list", ".txt", depth_files.frame_lists, _text(depth_files.LIST_WORDS), depth_files.check_list),
    Target("depth-recordings", ".yaml", depth_files.recordings, _YAML, depth_files.check_recordings, (KinedexError,),
           60_000),
)  # fmt: skip
"""The readers of depth recordings."""

_IMU = tuple(
    Target(
        f"imu-{name}",
        ending,
        made,
        mutations,
        imu_files.check_hdf5 if name == "hdf5" else imu_files.check_recording,
    )
    for name, ending, made, mutations in (
        ("mtmanager", ".txt", imu_files.mtmanager, _text(imu_files.XSENS_WORDS)),
        ("dot", ".csv", imu_files.dot, _text(imu_files.XSENS_WORDS)),
        ("opal", ".csv", imu_files.opal, _text(imu_files.COLUMN_WORDS)),
        ("xio", ".csv", imu_files.xio, _text(imu_files.COLUMN_WORDS)),
        ("mvnx", ".mvnx", imu_files.mvnx, _text(MVNX_WORDS, DEEP_MVNX)),
        ("csv", ".csv", imu_files.tables, _text(imu_files.COLUMN_WORDS)),
        ("parquet", ".parquet", imu_files.parquet, ANY),
        ("hdf5", ".h5", imu_files.hdf5, ANY),
    )
)
"""The readers of inertial sensors."""

_SENSORS = Target(
    "sensors-yaml", ".yaml", imu_files.sensor_sets, _YAML, imu_files.check_sensor_set, (KinedexError,), 60_000
)

TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        Target("asf", ".asf", partial(seeds.acclaim, 0), _text(ASF_WORDS), check_asf),
        Target("amc", ".amc", partial(seeds.acclaim, 1), _text(AMC_WORDS), check_amc),
        Target("bvh", ".bvh", seeds.bvh, _text(BVH_WORDS, DEEP_BVH), check_motion),
        Target("bvh-parser", ".bvh", seeds.strange_bvh, _text(BVH_WORDS, DEEP_BVH), check_strange_bvh),
        Target("zip", ".zip", packed_files.archives, (*ANY, *packed_files.ZIP), packed_files.check_packed),
        Target("gz", ".gz", packed_files.packed_bvh, (*ANY, *packed_files.GZ), packed_files.check_packed),
        Target("trc", ".trc", seeds.trc, _text(), check_motion),
        Target("csv", ".csv", seeds.csv, _text(CSV_WORDS), check_csv),
        Target("motive", ".csv", seeds.motive, _text(MOTIVE_WORDS), check_motion),
        Target("nexus", ".csv", seeds.nexus, _text(NEXUS_WORDS), check_motion),
        Target("arena", ".csv", seeds.arena, _text(), check_motion),
        Target("qualisys", ".tsv", seeds.qualisys, _text(QUALISYS_WORDS), check_motion),
        Target("keypoints", ".json", seeds.keypoints, _text(KEYPOINT_WORDS, DEEP_YAML), check_motion),
        Target("humanml", ".npy", seeds.humanml, (*ANY, *NPY, *NPY), check_motion),
        Target("angle-pickle", ".pkl", seeds.angle_pickles, (*ANY, *TEXT), check_amass),
        Target("keypoint-pickle", ".pkl", seeds.pickled_keypoints, (*ANY, *TEXT), check_motion),
        Target("mot", ".mot", seeds.opensim_motion, _text(MOT_WORDS), check_opensim_motion),
        Target("osim", ".osim", seeds.opensim_model, _text(OSIM_WORDS, DEEP_EAF), check_opensim_model),
        Target("npy", ".npy", seeds.npy, (*ANY, *NPY, *NPY), check_motion),
        Target("npz", ".npz", seeds.npz, (*ANY, *NPZ, *NPZ), check_motion),
        Target("mvnx", ".mvnx", seeds.mvnx, _text(MVNX_WORDS, DEEP_MVNX), check_persons),
        Target("glb", ".glb", seeds.glb, (*ANY, *GLB), check_persons),
        Target("gltf", ".gltf", seeds.gltf, _text(GLTF_WORDS, DEEP_YAML), check_persons),
        Target("fbx", ".fbx", seeds.fbx, (*ANY, *FBX), check_persons),
        Target("fbx-text", ".fbx", seeds.fbx_text, _text(FBX_WORDS, DEEP_FBX), check_persons),
        Target("c3d", ".c3d", seeds.c3d, (*ANY, *C3D, *C3D), check_motion),
        Target("c3d-parser", ".c3d", seeds.strange_c3d, (*ANY, *C3D, *C3D), check_strange_c3d),
        Target("amass", ".npz", seeds.amass, (*ANY, *NPZ, *NPZ), check_amass),
        Target("body-model", ".npz", seeds.body_models, (*ANY, *NPZ, *NPZ), check_body_model),
        Target("ground-truth", ".csv", seeds.ground_truth, _text(CSV_WORDS), check_ground_truth),
        Target("metadata", ".csv", seeds.metadata, _text(CSV_WORDS), check_metadata),
        Target("metadata-yaml", ".yaml", seeds.metadata_yaml, _YAML, check_metadata, (KinedexError,), 60_000),
        *(
            Target(f"labels-{ending}", f".{ending}", partial(seeds.label_file, ending), mutations, check_ground_truth)
            for ending, mutations in (
                ("eaf", _text(EAF_WORDS, DEEP_EAF)), ("vtt", _text(VTT_WORDS)), ("txt", _text((b"\\", b"\t"))),
                ("json", _text(JSON_WORDS, DEEP_YAML)),
            )
        ),
        *(
            Target(f"yaml-{kind}", ".yaml", partial(seeds.shipped, kind), _YAML, check, (KinedexError,), 60_000)
            for kind, check in (
                ("queries", check_queries), ("skeletons", check_skeleton), ("pipelines", check_pipeline),
                ("features", check_features), ("classes", check_classes),
                ("keypoints", camera_files.check_keypoint_set),
            )
        ),
        *_CAMERAS,
        *_DEPTH,
        *_IMU,
        _SENSORS,
    )
}  # fmt: skip
"""All targets by name."""
