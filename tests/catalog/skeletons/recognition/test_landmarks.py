"""The vocabulary of markers: what it has for the left side serves the right one."""

from __future__ import annotations

from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks


def test_joints_of_the_right_side_take_the_landmarks_of_the_right_side() -> None:
    found = load_landmarks()
    for joint, choices in found.joints.items():
        if joint[0] != "r" or f"l{joint[1:]}" not in found.joints:
            continue
        for right, left in zip(choices, found.joints[f"l{joint[1:]}"], strict=True):
            for (a, _), (b, _) in zip(right.weights, left.weights, strict=True):
                sided = f"{'lr'['rl'.index(b[0])]}{b[1:]}" if b[0] in "lr" else b
                assert a in (b, sided)
                assert a != b or b[0] not in "lr" or sided not in {*found.points, *found.order}, (joint, a)
