"""Seeds of the fuzzing: small valid files of every format, made here or cut out of real ones where these are there."""

from __future__ import annotations

import io
import json
import pickle
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from kinedex.catalog.configs import config_names, config_path
from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.catalog.skeletons.mappings import Mappings, load_mappings, load_skeleton
from kinedex.storage.formats.labels.file_labels import Label, LabelsOfTake
from kinedex.storage.formats.labels.formats import FORMATS
from kinedex.storage.formats.motion.body_models import BODY, HANDS
from tests import osim_files, point_files, real_data
from tests.bodies import STANDING, standing
from tests.bvh_files import bvh_text, dance, mixamo, small
from tests.c3d_files import standing_markers, write_c3d
from tests.fbx_files import dancing_fbx
from tests.gltf_files import dancing_gltf
from tests.mvnx_files import dancing, mvnx_text, subject_text
from tests.pipelines.archives import human_amc, human_asf

SHARED = real_data.SHARED / "data"
SMALL = 60_000
"""Seeds have no more bytes than this, so that many mutants are read in a second."""


@lru_cache(maxsize=1)
def known() -> tuple[FeatureSet, Mappings]:
    feature_set = load_feature_set()
    return feature_set, load_mappings("auto", feature_set.joints)


@lru_cache(maxsize=1)
def pairs() -> dict[str, tuple[bytes, bytes]]:
    """Pairs of ASF and AMC texts by name."""
    pairs = {"human": (human_asf().encode(), human_amc(4, seed=1).encode())}
    for name, motion, skeleton in (
        ("hdm05", "hdm05/takes/*.amc", "hdm05/takes/*.asf"),
        ("cmu", "cmu/01/*.amc", "cmu/01/*.asf"),
    ):
        amc, asf = next(iter(sorted(SHARED.glob(motion))), None), next(iter(sorted(SHARED.glob(skeleton))), None)
        if amc is not None and asf is not None:
            pairs[name] = (asf.read_bytes(), _frames(amc.read_bytes(), b"\n3"))
    return pairs


def acclaim(which: int) -> dict[str, bytes]:
    return {name: pair[which] for name, pair in pairs().items()}


def _frames(data: bytes, end: bytes) -> bytes:
    """The first frames of an AMC file, up to the line that is a frame's number."""
    at = min((place for line in (b"\n", b"\r\n") if (place := data.find(end + line)) > 0), default=len(data))
    return data[: at + 1]


def bvh() -> dict[str, bytes]:
    seeds = {
        "mixamo": bvh_text(mixamo(), dance(mixamo(), 4)).encode(),
        "dos": bvh_text(mixamo(), dance(mixamo(), 3), newline="\r\n", frame_time="8.33333e-03").encode(),
    }
    for name, pattern in (("bandai", "bandai/dataset-1*/**/*.bvh"), ("cmu", "cmu/**/*.bvh")):
        path = next(iter(sorted(SHARED.glob(pattern))), None)
        if path is not None:
            seeds[name] = b"\n".join(path.read_bytes()[:SMALL].split(b"\n")[:-1]) + b"\n"
    return seeds


def strange_bvh() -> dict[str, bytes]:
    """Parsed, but of a skeleton that no mapping fits; the parser is the target."""
    return {"small": bvh_text(small(), dance(small(), 4)).encode()}


def _walk(frames: int = 5) -> np.ndarray:
    """The standing figure, walking: (frames, joints, 3) in metres."""
    points = standing(frames).transpose(2, 0, 1).copy()
    points[:, :, 2] += np.arange(frames)[:, None] * 0.01
    return points


def csv() -> dict[str, bytes]:
    header = ["frame", "time", *(f"{joint}_{axis}" for joint in STANDING for axis in "xyz")]
    rows = [f"{t},{t / 30:.4f}," + ",".join(f"{x:.5g}" for x in row.ravel()) for t, row in enumerate(_walk())]
    text = "\n".join([",".join(header), *rows, ""])
    gaps = text.replace("1.0,", "nan,", 1)
    quoted = "\r\n".join([",".join(f'"{cell}"' for cell in line.split(",")) for line in text.splitlines()])
    return {"plain": text.encode(), "gaps": gaps.encode(), "quoted": quoted.encode()}


def motive() -> dict[str, bytes]:
    """Bones of two skeletons, and markers with gaps."""
    gaps = 1000 * point_files.walk()
    gaps[1:3, 4] = np.nan
    names = [f"Ann:{joint}" for joint in STANDING]
    bones = point_files.motive_csv(point_files.walk(), names, unit="Meters", version="1.25", timecode=True)
    return {"bones": bones.encode(), "markers": point_files.motive_csv(gaps, names, kind="Marker").encode()}


def nexus() -> dict[str, bytes]:
    """Sections of Nexus, and a file of Workstation."""
    points = point_files.walk()
    sections = point_files.nexus_csv(1000 * points, list(STANDING), before=point_files.DEVICES, after=",,\r\n")
    return {"nexus": sections.encode(), "workstation": point_files.workstation_csv(points, list(STANDING)).encode()}


def arena() -> dict[str, bytes]:
    """Files of OptiTrack's older programs: markers with names, and rigid bodies."""
    points, names = point_files.walk(), list(STANDING)
    return {
        "markers": point_files.arena_csv(points, names).encode(),
        "bodies": point_files.arena_csv(points, names, version="1", bodies=True, hand="lefthanded").encode(),
    }


def opensim_motion() -> dict[str, bytes]:
    """A motion in degrees, and states in radians."""
    values = {name: [0.1 * i, 0.2, 0.3] for i, name in enumerate(osim_files.coordinates())}
    states = osim_files.motion(values, degrees="no", states=True)
    return {"degrees": osim_files.motion(values).encode(), "states": states.encode()}


def opensim_model() -> dict[str, bytes]:
    return {f"version-{version}": osim_files.model(version).encode() for version in (3, 4)}


def qualisys() -> dict[str, bytes]:
    """Markers with heads of columns, and without, some not seen."""
    points = 1000 * point_files.walk() + 500
    gaps = points.copy()
    gaps[2, 5] = np.nan
    bare = point_files.qualisys_tsv(gaps, list(STANDING), heads=False, leading=0, missing="NULL")
    return {"heads": point_files.qualisys_tsv(points, list(STANDING)).encode(), "bare": bare.encode()}


def keypoints() -> dict[str, bytes]:
    """Frames of a list and of MMPose with names, and a frame of OpenPose."""
    walk = point_files.keypoints_of(load_keypoint_set("coco-17").order, 4)
    plain = {"fps": 30, "frames": [{"keypoints_3d": places.tolist()} for places in walk.round(4)]}
    mmpose = {"meta_info": {"keypoint_id2name": dict(enumerate(load_keypoint_set("coco-17").order))}, "fps": 30}
    mmpose["instance_info"] = [{"instances": [{"track_id": 7, "keypoints": p.tolist()}]} for p in walk.round(4)]
    flat = [*point_files.keypoints_of(load_keypoint_set("body-25").order, 1)[0].round(3).ravel().tolist()]
    one = {"fps": 30, "people": [{"person_id": [-1], "pose_keypoints_3d": flat}]}
    return {"plain": json.dumps(plain).encode(), "mmpose": json.dumps(mmpose).encode(), "one": json.dumps(one).encode()}


def trc() -> dict[str, bytes]:
    names = list(STANDING)
    points = _walk()
    lines = ["PathFileType\t4\t(X/Y/Z)\ta.trc"]
    lines += ["DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"]
    lines += [f"60.00\t60.00\t{len(points)}\t{len(names)}\tm\t60.00\t1\t{len(points)}"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t"]
    lines += ["\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, len(names) + 1)), ""]
    for t, row in enumerate(points):
        lines.append(f"{t + 1}\t{t / 60:.4f}\t" + "\t".join(f"{x:.6g}" for x in row.ravel()))
    return {"plain": "\n".join([*lines, ""]).encode(), "dos": "\r\n".join([*lines, ""]).encode()}


def npy() -> dict[str, bytes]:
    order = load_skeleton("smpl-24", known()[0].joints).order
    coco = load_skeleton("coco-17", known()[0].joints).order
    return {str(len(names)): _saved(_figure(names)) for names in (order, coco)}


def _figure(names: tuple[str, ...], frames: int = 5) -> np.ndarray:
    """The standing figure as the points of a mapping, in its order: (frames, points, 3)."""
    mappings = [m for m in known()[1].of_format["positions"] if m.order == names]
    place: dict[str, tuple[float, float, float]] = {}
    for joint, mixes in mappings[0].joints.items():
        for mix in mixes:
            if mix is not None and mix.node is not None:
                place.setdefault(mix.node, STANDING[joint])
    pose = np.array([place.get(name, STANDING["head"]) for name in names], dtype=float)
    walk = np.repeat(pose[None], frames, axis=0)
    walk[:, :, 2] += np.arange(frames)[:, None] * 0.01
    return walk


def _saved(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz() -> dict[str, bytes]:
    seeds = {}
    for pack in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        pack(file, positions=_walk(), names=np.array(list(STANDING)), fps=np.float64(60.0))
        seeds[pack.__name__] = file.getvalue()
    return seeds


def mvnx() -> dict[str, bytes]:
    """A person, and two in a file."""
    one, two = subject_text(*dancing(3)), subject_text(*dancing(2, seed=1), label="Bo", suit="UpperBody")
    return {"one": mvnx_text([one]).encode(), "two": mvnx_text([one, two], version=3).encode()}


def glb() -> dict[str, bytes]:
    """A figure of a skin with one clip, and one without a skin with two."""
    one, two = dancing_gltf(mixamo(), dance(mixamo(), 4)), dancing_gltf(mixamo(), dance(mixamo(), 3), skin=False)
    places = {node["name"]: i for i, node in enumerate(two.json["nodes"])}
    two.clip("jump", places, mixamo(), dance(mixamo(), 2, seed=1))
    return {"skin": one.glb(), "clips": two.glb()}


def gltf() -> dict[str, bytes]:
    """The same with the numbers in the JSON."""
    return {"skin": dancing_gltf(mixamo(), dance(mixamo(), 3)).gltf()}


def fbx() -> dict[str, bytes]:
    """Binary files of both widths of numbers, packed and not."""
    scene = dancing_fbx(mixamo(), dance(mixamo(), 3))
    return {"narrow": scene.binary(7400), "wide": scene.binary(7700), "plain": scene.binary(7300, packed=False)}


def fbx_text() -> dict[str, bytes]:
    """The same as text."""
    return {"text": dancing_fbx(mixamo(), dance(mixamo(), 3)).text()}


def c3d() -> dict[str, bytes]:
    """Markers in millimetres and metres, with gaps and analog channels."""
    points = standing_markers(6)
    gaps = 1000 * points.copy()
    gaps[3, :, 2:4] = np.nan
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "seed.c3d"
        return {
            "millimetres": write_c3d(path, gaps, first=9).read_bytes(),
            "analog": write_c3d(path, points, unit="m", analog=3, Y_SCREEN=["+Y"]).read_bytes(),
        }


def strange_c3d() -> dict[str, bytes]:
    """Parsed, but of markers that no mapping fits: those of a vendor's system where it is there, and made ones."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_c3d(Path(folder) / "seed.c3d", standing_markers(3)[:2], ("a", "b"))
        seeds = {"two": path.read_bytes()}
    file = SHARED / "c3d" / "Optotrak.c3d"
    return seeds | ({"optotrak": file.read_bytes()} if file.is_file() else {})


def amass() -> dict[str, bytes]:
    """Joint angles as older and as newer files hold them."""
    rotations = np.random.default_rng(0).normal(0, 0.2, (4, 3 * len((*BODY, *HANDS))))
    places, rate = np.zeros((4, 3)), np.array(60.0)
    old = {
        "poses": rotations,
        "trans": places,
        "betas": np.zeros(16),
        "gender": np.array("female"),
        "mocap_framerate": rate,
    }
    new = {
        "root_orient": rotations[:, :3],
        "pose_body": rotations[:, 3:66],
        "pose_hand": rotations[:, 66:],
        "trans": places,
    }
    new |= {"mocap_frame_rate": rate, "gender": np.array(b"neutral")}
    return {"old": _zipped(old), "new": _zipped(new)}


def angle_pickles() -> dict[str, bytes]:
    """Angles as AIST++ and as estimators have them, of protocols that a mutation leaves whole now and then."""
    rotations = np.random.default_rng(0).normal(0, 0.2, (4, 72))
    aist = {"smpl_poses": rotations, "smpl_scaling": np.array([93.0]), "smpl_trans": np.zeros((4, 3))}
    parts = {
        "global_orient": rotations[:, None, :3],
        "body_pose": rotations[:, 3:].reshape(4, 23, 3),
        "transl": np.zeros((4, 3)),
    }
    return {f"aist-{p}": pickle.dumps(aist, p) for p in (0, 2)} | {"parts": pickle.dumps(parts | {"fps": 30.0}, 4)}


def pickled_keypoints() -> dict[str, bytes]:
    walk = point_files.keypoints_of(load_keypoint_set("coco-17").order, 4)
    return {f"protocol-{p}": pickle.dumps({"keypoints3d": 100 * walk}, p) for p in (0, 2, 5)}


def humanml() -> dict[str, bytes]:
    """The places of 22 joints, and features of a body that stands still."""
    rest = _figure(load_skeleton("smpl-24", known()[0].joints).order)[:, :22]
    features = np.zeros((5, 263))
    features[:, 3], features[:, 4:67] = rest[:, 0, 1], (rest - rest[:, :1] * [1, 0, 1])[:, 1:].reshape(5, -1)
    return {"joints": _saved(rest), "features": _saved(features)}


def body_model() -> bytes:
    """A table of joints at rest, for whatever angles."""
    places = np.random.default_rng(1).normal(0, 0.3, (len(BODY), 3)) + np.array([0.0, 1.0, 0.0])
    return _zipped({"joints": places, "names": np.array(BODY), "shapes": np.full((len(BODY), 3, 4), 0.01)})


def body_models() -> dict[str, bytes]:
    """Return small body models of both kinds: a table of joints, and a model with its regressor."""
    random = np.random.default_rng(2)
    model = {"v_template": random.normal(0, 1, (30, 3)), "J_regressor": random.uniform(0, 0.1, (len(BODY), 30))}
    return {"table": body_model(), "model": _zipped(model | {"shapedirs": random.normal(0, 0.1, (30, 3, 5))})}


def _zipped(arrays: dict[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def ground_truth() -> dict[str, bytes]:
    text = "take,class,start,stop,by\nHDM_mm_1,walk,0,120,me\nHDM_mm_1,'turn',120,1000,\n\nHDM_mm_2,hop,5,9,\"a, b\"\n"
    return {"plain": text.encode(), "mark": b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()}


def metadata() -> dict[str, bytes]:
    """A table of a script, and one of a German Excel."""
    plain = 'take,licence,mass,tags[],code\nt0,free,71.5,slow|calm,007\na/t1.bvh,"bought, once",80,,008\nt*,,,,\n'
    excel = 'sep=;\r\nDatei;Lizenz für;Masse;innen\r\nt0;"frei\nhier";71,5;WAHR\r\nt2.bvh;;80;FALSCH\r\n'
    return {"plain": plain.encode(), "excel": excel.encode("cp1252"), "wide": excel.encode("utf-16")}


def metadata_yaml() -> dict[str, bytes]:
    by_take = "t0: {licence: free, tags: [slow, calm], mass: 71.5}\n'*': {licence: bought, day: 2024-05-01}\n"
    return {"mapping": by_take.encode(), "list": b"- {file: t0, n: 1}\n- {file: a/t1.bvh, n: 2.5, ok: true}\n"}


def _labels() -> LabelsOfTake:
    made = (Label("walk", 0, 120, "walk", 0.1, 0.9), Label("kick & turn", 100, 200), Label("walk", 110, 300))
    return LabelsOfTake("take <1>", 120.0, 400, made)


def label_file(ending: str) -> dict[str, bytes]:
    """A file as kinedex writes it, and one as other programs do."""
    own = FORMATS[ending].write([_labels()])
    if ending == "eaf":
        other = own.replace(">walk<", "><").replace("<HEADER", "<LICENSE/>\n<HEADER").replace("UTF-8", "utf-8")
    elif ending == "vtt":
        other = (
            "WEBVTT a title\r\n\r\nSTYLE\r\n::cue {}\r\n\r\n00:01.000 --> 00:02.500 align:start\r\n<c.x>walk</c>\r\n"
        )
    elif ending == "json":
        other = '{"takes": [{"take": "a", "segments": [{"class": "b", "start_seconds": 0.5, "stop_seconds": 1}]}]}'
    else:
        other = "\ufeff0.5\t1.25\twalk\n\\\t100.0\t200.0\n\n3\t4.5\tkick\tand turn\n"
    return {"own": own.encode(), "other": other.encode()}


def shipped(kind: str) -> dict[str, bytes]:
    return {name: config_path(kind, name).read_bytes() for name in config_names(kind)}
