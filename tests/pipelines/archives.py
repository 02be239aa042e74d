"""Small archives and stage contexts for the tests of pipelines."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from rich.console import Console

from kinedex.catalog.features import load_feature_set
from kinedex.console.terminal import Terminal
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.executors import make_executor

PARENTS = {
    "lhipjoint": "root", "lfemur": "lhipjoint", "ltibia": "lfemur", "lfoot": "ltibia", "ltoes": "lfoot",
    "rhipjoint": "root", "rfemur": "rhipjoint", "rtibia": "rfemur", "rfoot": "rtibia", "rtoes": "rfoot",
    "lowerback": "root", "upperback": "lowerback", "thorax": "upperback", "lowerneck": "thorax",
    "upperneck": "lowerneck", "head": "upperneck", "lclavicle": "thorax", "lhumerus": "lclavicle",
    "lradius": "lhumerus", "lwrist": "lradius", "lhand": "lwrist", "lfingers": "lhand", "rclavicle": "thorax",
    "rhumerus": "rclavicle", "rradius": "rhumerus", "rwrist": "rradius", "rhand": "rwrist", "rfingers": "rhand",
}  # fmt: skip
"""Bone → parent of the skeletons that the shipped Acclaim mapping fits."""

DIRECTIONS = {"femur": (0, -1, 0), "tibia": (0, -1, 0), "foot": (0, -0.5, 1), "toes": (0, 0, 1)}


def human_asf() -> str:
    """A plain human ASF skeleton, every bone with three turns."""
    lines = [":version 1.10", ":units", " length 0.45", " angle deg", ":root", " order TX TY TZ RX RY RZ", " axis XYZ"]
    lines += [" position 0 0 0", " orientation 0 0 0", ":bonedata"]
    for bone in PARENTS:
        side = 1.0 if bone.startswith("l") and not bone.startswith("lower") else -1.0
        spine = (0.0, 1.0, 0.0)
        known = next((vector for end, vector in DIRECTIONS.items() if bone.endswith(end)), None)
        limb = any(bone.endswith(end) for end in ("joint", "clavicle", "humerus", "radius", "wrist", "hand", "fingers"))
        direction = known or ((side, -0.3, 0.0) if limb else spine)
        lines += [" begin", f"  name {bone}", "  direction " + " ".join(map(str, direction))]
        lines += [f"  length {7.0 if known else 3.0}", "  axis 0 0 0 XYZ", "  dof rx ry rz", " end"]
    lines += [":hierarchy", " begin", *(f" {parent} {bone}" for bone, parent in PARENTS.items()), " end", ""]
    return "\n".join(lines)


def human_amc(frames: int, seed: int) -> str:
    """A slow random dance."""
    random = np.random.default_rng(seed)
    phases, speeds = random.uniform(0, 6, (len(PARENTS), 3)), random.uniform(1, 4, (len(PARENTS), 3))
    lines = [":FULLY-SPECIFIED", ":DEGREES"]
    for t in range(frames):
        lines += [str(t + 1), f"root 0 17 {t * 0.01:.4f} 0 {t * 0.3:.3f} 0"]
        angles = 40.0 * np.sin(phases + speeds * t / 120)
        lines += [f"{bone} {a:.4f} {b:.4f} {c:.4f}" for bone, (a, b, c) in zip(PARENTS, angles, strict=True)]
    return "\n".join(lines) + "\n"


def write_archive(root: Path, takes: dict[str, int], first_seed: int = 0) -> Path:
    """An archive of takes (path → frames), with one skeleton at the root."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "x.asf").write_text(human_asf())
    for seed, (path, frames) in enumerate(takes.items(), first_seed):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(human_amc(frames, seed))
    return root


def context(store: Path, stage: str = "ingest", executor: str = "serial") -> StageContext:
    """A stage context that prints nothing on the terminal."""
    terminal = Terminal(Console(file=io.StringIO()))
    return StageContext(store, load_feature_set(), "test", stage, "run-1", make_executor(executor), terminal)
