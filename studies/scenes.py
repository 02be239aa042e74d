"""`python -m studies.scenes PYTHON TAKE.bvh…`: compare takes with what Blender exports of them as glTF and FBX.

PYTHON is an interpreter that has Blender as a module (`pip install bpy`).
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import features
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body

FEATURES = load_feature_set()
SECONDS = 600
EXPORT = """
import sys
import bpy

source, target, unit = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_anim.bvh(filepath=source, global_scale=float(unit), update_scene_fps=True, update_scene_duration=True)
bpy.ops.export_scene.gltf(filepath=target + ".glb", export_force_sampling=True)
bpy.ops.export_scene.fbx(
    filepath=target + ".fbx", object_types={"ARMATURE"}, bake_anim_simplify_factor=0.0, add_leaf_bones=False
)
"""


def main() -> None:
    """Print for each take and format the largest distance of a joint, and the fraction of equal words."""
    parser = argparse.ArgumentParser(prog="python -m studies.scenes", description=__doc__)
    parser.add_argument("python", type=Path, metavar="PYTHON")
    parser.add_argument("takes", type=Path, nargs="+", metavar="TAKE.bvh")
    given = parser.parse_args()
    print("| take | format | frames | mapping | farthest joint | words equal |\n|---|---|---|---|---|---|")
    for take in given.takes:
        expected = _read(take)
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "take"
            command = [str(given.python), "-c", EXPORT, str(take), str(target), expected.unit.split()[0]]
            subprocess.run(command, check=True, capture_output=True, timeout=SECONDS)
            for ending in (".glb", ".fbx"):
                print(f"| {take.stem} | {ending[1:]} | {_compared(_read(target.with_suffix(ending)), expected)} |")


def _read(path: Path) -> Body:
    return read_body(path, None, load_mappings("auto", FEATURES.joints), FEATURES.joints)


def _compared(body: Body, expected: Body) -> str:
    """Return frames, mapping, the largest distance of a joint that neither file lacks, and the share of equal words."""
    frames = min(body.frames, expected.frames)
    apart = np.linalg.norm(body.positions[..., :frames] - expected.positions[..., :frames], axis=1)
    for name in {*body.estimated, *expected.estimated}:
        apart[FEATURES.joints.index(name)] = np.nan
    joint = int(np.argmax(np.nan_to_num(apart).max(axis=1)))
    words = [_words(one, frames) for one in (body, expected)]
    equal = 100.0 * float(np.mean(words[0] == words[1]))
    farthest = f"{1000 * float(np.nanmax(apart)):.3f} mm ({FEATURES.joints[joint]})"
    return f"{frames} | {body.skeleton} | {farthest} | {equal:.1f} %"


def _words(body: Body, frames: int) -> np.ndarray:
    return features.words(body.positions[..., :frames], body.orientation[:, :frames], body.rate_hz, FEATURES.rules)


if __name__ == "__main__":
    main()
