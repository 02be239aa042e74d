"""Names of the keypoints of pose estimators, in the order in which their files hold them."""

from __future__ import annotations

_BODY = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")

COCO_17 = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear",
    *(f"{side}_{part}" for part in _BODY for side in ("left", "right")),
)  # fmt: skip

COCO_18 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear",
)  # fmt: skip
"""OpenPose's model of COCO, which adds the neck."""

BODY_25 = (
    *COCO_18[:8], "mid_hip", *COCO_18[8:], "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
)  # fmt: skip

HALPE_26 = (
    *COCO_17, "head_top", "neck", "mid_hip", "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe",
    "left_heel", "right_heel",
)  # fmt: skip

MEDIAPIPE_33 = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right",
    *(f"{side}_{part}" for part in (*_BODY[:3], "pinky", "index", "thumb", *_BODY[3:], "heel", "foot_index")
      for side in ("left", "right")),
)  # fmt: skip

BY_COUNT = {len(names): names for names in (COCO_17, COCO_18, BODY_25, HALPE_26, MEDIAPIPE_33)}
"""Number of keypoints → their names, for files that name none."""
