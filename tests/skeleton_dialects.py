"""Human skeletons in the dialects of many programs: one body, under the names and with the trees of each.

A dialect is a list of nodes, parted by slashes: a name, the name of its parent, and where it begins. Places are codes
of `PLACES`; `s0.4` is 40 % of the way from root to neck, and `a~b:0.5` lies halfway between a and b. A node with `{}`
stands for both sides, whose marks the dialect gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.body_evidence import Evidence

F64 = npt.NDArray[np.float64]

PLACES = {
    "root": (0.0, 0.97, 0.0), "neck": (0.0, 1.42, -0.02), "head": (0.0, 1.56, 0.0), "top": (0.0, 1.72, 0.02),
    "hip": (0.09, 0.92, 0.0), "knee": (0.10, 0.50, 0.01), "ankle": (0.10, 0.09, -0.02),
    "ball": (0.11, 0.02, 0.10), "toe": (0.115, 0.01, 0.16), "heel": (0.10, 0.02, -0.06),
    "clav": (0.03, 1.38, 0.0), "sho": (0.18, 1.40, -0.02), "elb": (0.46, 1.39, -0.04), "wri": (0.71, 1.38, -0.01),
    "palm": (0.75, 1.38, -0.01), "thumb": (0.74, 1.37, 0.03), "index": (0.80, 1.38, 0.02), "knu": (0.80, 1.38, 0.0),
    "ring": (0.795, 1.38, -0.02), "little": (0.785, 1.375, -0.04), "tip": (0.90, 1.37, 0.0),
    "eye": (0.03, 1.62, 0.09), "floor": (0.0, 0.0, 0.0), "jaw": (0.0, 1.58, 0.06),
}  # fmt: skip
"""The places of joints of the left and the middle when the body stands, arms to the sides; metres, Y up, facing Z."""

JOINT_OF = {
    "root": "root", "neck": "neck", "head": "head", "hip": "hip", "knee": "knee", "ankle": "ankle", "sho": "shoulder",
    "elb": "elbow", "wri": "wrist",
}  # fmt: skip
"""Place → the named joint that is there."""


@dataclass(frozen=True)
class Dialect:
    """The nodes of a dialect, and the marks of its left and right side."""

    lines: str
    sides: tuple[str, str] = ("Left", "Right")


DIALECTS = {
    "lafan1": Dialect(
        "Hips - root/{}UpLeg Hips hip/{}Leg {}UpLeg knee/{}Foot {}Leg ankle/{}Toe {}Foot ball/"
        "{}Toe_end {}Toe toe/Spine Hips s0.25/Spine1 Spine s0.5/Spine2 Spine1 s0.75/Neck Spine2 neck/"
        "Head Neck head/Head_end Head top/{}Shoulder Spine2 clav/{}Arm {}Shoulder sho/{}ForeArm {}Arm elb/"
        "{}Hand {}ForeArm wri/{}Hand_end {}Hand knu"
    ),
    "sfu": Dialect(
        "Hips - root/{}UpLeg Hips hip/{}Leg {}UpLeg knee/{}Foot {}Leg ankle/{}ToeBase {}Foot ball/"
        "{}ToeBase_end {}ToeBase toe/Spine Hips s0.3/Spine1 Spine s0.6/Neck Spine1 neck/Head Neck head/"
        "Head_end Head top/{}Shoulder Spine1 clav/{}Arm {}Shoulder sho/{}ForeArm {}Arm elb/{}Hand {}ForeArm wri/"
        "{}HandThumb {}Hand thumb/{}HandThumb_end {}HandThumb index/L_Wrist_End {}Hand knu"
    ),
    "accad": Dialect(
        "Hips - root/ToSpine Hips s0.01/Spine ToSpine s0.3/Spine1 Spine s0.6/Neck Spine1 neck/Head Neck head/"
        "Head_end Head top/{}Shoulder Spine1 clav/{}Arm {}Shoulder sho/{}ForeArm {}Arm elb/{}Hand {}ForeArm wri/"
        "{}Hand_end {}Hand knu/{}UpLeg Hips hip/{}Leg {}UpLeg knee/{}Foot {}Leg ankle/{}ToeBase {}Foot ball/"
        "{}ToeBase_end {}ToeBase toe"
    ),
    "xsens": Dialect(
        "Hips - root/Chest Hips s0.2/Chest2 Chest s0.4/Chest3 Chest2 s0.6/Chest4 Chest3 s0.8/Neck Chest4 neck/"
        "Head Neck head/Head_end Head top/{}Collar Chest4 clav/{}Shoulder {}Collar sho/{}Elbow {}Shoulder elb/"
        "{}Wrist {}Elbow wri/{}Wrist_end {}Wrist tip/{}Hip Hips hip/{}Knee {}Hip knee/{}Ankle {}Knee ankle/"
        "{}Toe {}Ankle ball/{}Toe_end {}Toe toe"
    ),
    "xsens segments": Dialect(
        "Pelvis - root/L5 Pelvis s0.15/L3 L5 s0.35/T12 L3 s0.55/T8 T12 s0.75/Neck T8 neck/Head Neck head/"
        "Head_end Head top/{}Shoulder T8 clav/{}UpperArm {}Shoulder sho/{}ForeArm {}UpperArm elb/"
        "{}Hand {}ForeArm wri/{}UpperLeg Pelvis hip/{}LowerLeg {}UpperLeg knee/{}Foot {}LowerLeg ankle/"
        "{}Toe {}Foot ball"
    ),
    "perception neuron": Dialect(
        "Hips - root/{}UpLeg Hips hip/{}Leg {}UpLeg knee/{}Foot {}Leg ankle/{}Foot_end {}Foot toe/"
        "Spine Hips s0.2/Spine1 Spine s0.45/Spine2 Spine1 s0.65/Spine3 Spine2 s0.8/Neck Spine3 neck/"
        "Head Neck head/Head_end Head top/{}Shoulder Spine3 clav/{}Arm {}Shoulder sho/{}ForeArm {}Arm elb/"
        "{}Hand {}ForeArm wri/{}HandThumb1 {}Hand thumb/{}HandThumb1_end {}HandThumb1 index/"
        "{}InHandIndex {}Hand palm/{}HandIndex1 {}InHandIndex index/{}HandIndex1_end {}HandIndex1 tip/"
        "{}InHandMiddle {}Hand palm/{}HandMiddle1 {}InHandMiddle knu/{}HandMiddle1_end {}HandMiddle1 tip"
    ),
    "rokoko": Dialect(
        "Root - floor/Hips Root root/Spine1 Hips s0.2/Spine2 Spine1 s0.4/Spine3 Spine2 s0.6/Spine4 Spine3 s0.8/"
        "Neck Spine4 neck/Head Neck head/Head_end Head top/{}Shoulder Spine4 clav/{}Arm {}Shoulder sho/"
        "{}ForeArm {}Arm elb/{}Hand {}ForeArm wri/{}Finger1Metacarpal {}Hand thumb/"
        "{}Finger3Metacarpal {}Hand palm/{}Finger3Proximal {}Finger3Metacarpal knu/{}Thigh Hips hip/"
        "{}Shin {}Thigh knee/{}Foot {}Shin ankle/{}Toe {}Foot ball/{}ToeEnd {}Toe toe"
    ),
    "unity": Dialect(
        "Armature - floor/Hips Armature root/Spine Hips s0.25/Chest Spine s0.5/UpperChest Chest s0.75/"
        "Neck UpperChest neck/Head Neck head/{}Eye Head eye/{}Shoulder UpperChest clav/{}UpperArm {}Shoulder sho/"
        "{}LowerArm {}UpperArm elb/{}Hand {}LowerArm wri/{}ThumbProximal {}Hand thumb/"
        "{}MiddleProximal {}Hand knu/{}MiddleIntermediate {}MiddleProximal tip/{}UpperLeg Hips hip/"
        "{}LowerLeg {}UpperLeg knee/{}Foot {}LowerLeg ankle/{}Toes {}Foot ball"
    ),
    "unreal": Dialect(
        "root - floor/pelvis root root/spine_01 pelvis s0.2/spine_02 spine_01 s0.45/spine_03 spine_02 s0.7/"
        "neck_01 spine_03 neck/head neck_01 head/clavicle{} spine_03 clav/upperarm{} clavicle{} sho/"
        "upperarm_twist_01{} upperarm{} sho~elb:0.5/lowerarm{} upperarm{} elb/"
        "lowerarm_twist_01{} lowerarm{} elb~wri:0.6/hand{} lowerarm{} wri/thumb_01{} hand{} thumb/"
        "index_01{} hand{} index/middle_01{} hand{} knu/middle_02{} middle_01{} tip/pinky_01{} hand{} little/"
        "thigh{} pelvis hip/thigh_twist_01{} thigh{} hip~knee:0.5/calf{} thigh{} knee/"
        "calf_twist_01{} calf{} knee~ankle:0.5/foot{} calf{} ankle/ball{} foot{} ball/ik_foot_root root floor/"
        "ik_foot{} ik_foot_root ankle/ik_hand_root root floor/ik_hand{} ik_hand_root wri",
        ("_l", "_r"),
    ),
    "biped": Dialect(
        "Bip01 - root/Bip01_Footsteps Bip01 floor/Bip01_Pelvis Bip01 root/Bip01_Spine Bip01_Pelvis s0.2/"
        "Bip01_Spine1 Bip01_Spine s0.5/Bip01_Spine2 Bip01_Spine1 s0.75/Bip01_Neck Bip01_Spine2 neck/"
        "Bip01_Head Bip01_Neck head/Bip01_HeadNub Bip01_Head top/Bip01{}Clavicle Bip01_Neck clav/"
        "Bip01{}UpperArm Bip01{}Clavicle sho/Bip01{}Forearm Bip01{}UpperArm elb/"
        "Bip01{}ForeTwist Bip01{}Forearm elb~wri:0.4/Bip01{}Hand Bip01{}Forearm wri/"
        "Bip01{}Finger0 Bip01{}Hand thumb/Bip01{}Finger0Nub Bip01{}Finger0 index/"
        "Bip01{}Finger1 Bip01{}Hand index/Bip01{}Finger1Nub Bip01{}Finger1 tip/Bip01{}Finger2 Bip01{}Hand knu/"
        "Bip01{}Finger2Nub Bip01{}Finger2 tip/Bip01{}Finger3 Bip01{}Hand ring/Bip01{}Finger4 Bip01{}Hand little/"
        "Bip01{}Thigh Bip01_Spine hip/Bip01{}Calf Bip01{}Thigh knee/Bip01{}Foot Bip01{}Calf ankle/"
        "Bip01{}Toe0 Bip01{}Foot ball/Bip01{}Toe0Nub Bip01{}Toe0 toe",
        ("_L_", "_R_"),
    ),
    "poser": Dialect(
        "hip - root/abdomen hip s0.3/chest abdomen s0.6/neck chest neck/head neck head/{}Eye head eye/"
        "{}Collar chest clav/{}Shldr {}Collar sho/{}ForeArm {}Shldr elb/{}Hand {}ForeArm wri/"
        "{}Thumb1 {}Hand thumb/{}Mid1 {}Hand knu/{}Mid2 {}Mid1 tip/{}Buttock hip root~hip:0.4/"
        "{}Thigh {}Buttock hip/{}Shin {}Thigh knee/{}Foot {}Shin ankle/{}Foot_end {}Foot toe",
        ("l", "r"),
    ),
    "genesis": Dialect(
        "Genesis8Female - floor/hip Genesis8Female root/pelvis hip root/{}ThighBend pelvis hip/"
        "{}ThighTwist {}ThighBend hip~knee:0.5/{}Shin {}ThighTwist knee/{}Foot {}Shin ankle/"
        "{}Metatarsals {}Foot ankle~ball:0.4/{}Toe {}Metatarsals ball/{}BigToe {}Toe toe/abdomenLower hip s0.15/"
        "abdomenUpper abdomenLower s0.35/chestLower abdomenUpper s0.55/chestUpper chestLower s0.8/"
        "neckLower chestUpper neck/neckUpper neckLower neck~head:0.5/head neckUpper head/lowerJaw head jaw/"
        "{}Eye head eye/{}Collar chestUpper clav/{}ShldrBend {}Collar sho/{}ShldrTwist {}ShldrBend sho~elb:0.5/"
        "{}ForearmBend {}ShldrTwist elb/{}ForearmTwist {}ForearmBend elb~wri:0.5/{}Hand {}ForearmTwist wri/"
        "{}Carpal2 {}Hand palm/{}Mid1 {}Carpal2 knu/{}Mid2 {}Mid1 tip/{}Thumb1 {}Hand thumb",
        ("l", "r"),
    ),
    "biovision": Dialect(
        "Hips - root/Chest Hips s0.35/Chest2 Chest s0.6/Neck Chest2 neck/Head Neck head/Head_end Head top/"
        "{}Collar Chest2 clav/{}Shoulder {}Collar sho/{}Elbow {}Shoulder elb/{}Wrist {}Elbow wri/"
        "{}Wrist_end {}Wrist tip/{}Hip Hips hip/{}Knee {}Hip knee/{}Ankle {}Knee ankle/{}Ankle_end {}Ankle toe"
    ),
    "up and low": Dialect(
        "Hips - root/Chest Hips s0.4/Neck Chest neck/Head Neck head/Head_end Head top/{}Collar Chest clav/"
        "{}UpArm {}Collar sho/{}LowArm {}UpArm elb/{}Hand {}LowArm wri/{}Hand_end {}Hand tip/{}UpLeg Hips hip/"
        "{}LowLeg {}UpLeg knee/{}Foot {}LowLeg ankle/{}Foot_end {}Foot toe"
    ),
    "kinect": Dialect(
        "SpineBase - root/SpineMid SpineBase s0.5/SpineShoulder SpineMid s0.9/Neck SpineShoulder neck/"
        "Head Neck head/Shoulder{} SpineShoulder sho/Elbow{} Shoulder{} elb/Wrist{} Elbow{} wri/"
        "Hand{} Wrist{} knu/HandTip{} Hand{} tip/Thumb{} Hand{} thumb/Hip{} SpineBase hip/Knee{} Hip{} knee/"
        "Ankle{} Knee{} ankle/Foot{} Ankle{} toe"
    ),
    "azure": Dialect(
        "PELVIS - root/SPINE_NAVAL PELVIS s0.4/SPINE_CHEST SPINE_NAVAL s0.7/NECK SPINE_CHEST neck/HEAD NECK head/"
        "NOSE HEAD jaw/EYE{} HEAD eye/CLAVICLE{} SPINE_CHEST clav/SHOULDER{} CLAVICLE{} sho/"
        "ELBOW{} SHOULDER{} elb/WRIST{} ELBOW{} wri/HAND{} WRIST{} knu/HANDTIP{} HAND{} tip/"
        "THUMB{} WRIST{} thumb/HIP{} PELVIS hip/KNEE{} HIP{} knee/ANKLE{} KNEE{} ankle/FOOT{} ANKLE{} toe",
        ("_LEFT", "_RIGHT"),
    ),
    "smpl": Dialect(
        "Pelvis - root/{}_Hip Pelvis hip/{}_Knee {}_Hip knee/{}_Ankle {}_Knee ankle/{}_Foot {}_Ankle ball/"
        "Spine1 Pelvis s0.25/Spine2 Spine1 s0.5/Spine3 Spine2 s0.65/Neck Spine3 neck/Head Neck head/"
        "{}_Collar Spine3 clav/{}_Shoulder {}_Collar sho/{}_Elbow {}_Shoulder elb/{}_Wrist {}_Elbow wri/"
        "{}_Hand {}_Wrist knu",
        ("L", "R"),
    ),
    "smplx": Dialect(
        "pelvis - root/{}_hip pelvis hip/{}_knee {}_hip knee/{}_ankle {}_knee ankle/{}_foot {}_ankle ball/"
        "spine1 pelvis s0.25/spine2 spine1 s0.5/spine3 spine2 s0.65/neck spine3 neck/head neck head/jaw head jaw/"
        "{}_eye_smplhf head eye/{}_collar spine3 clav/{}_shoulder {}_collar sho/{}_elbow {}_shoulder elb/"
        "{}_wrist {}_elbow wri/{}_index1 {}_wrist index/{}_middle1 {}_wrist knu/{}_middle2 {}_middle1 tip/"
        "{}_pinky1 {}_wrist little/{}_thumb1 {}_wrist thumb",
        ("left", "right"),
    ),
    "genea": Dialect(
        "body_world - floor/b_root body_world root/b_spine0 b_root s0.1/b_spine1 b_spine0 s0.35/"
        "b_spine2 b_spine1 s0.55/b_spine3 b_spine2 s0.8/b_neck0 b_spine3 neck/b_head b_neck0 head/"
        "b_head_null b_head top/b_{}_shoulder b_spine3 clav/p_{}_scap b_{}_shoulder clav~sho:0.6/"
        "b_{}_arm b_{}_shoulder sho/b_{}_arm_twist b_{}_arm sho~elb:0.5/b_{}_forearm b_{}_arm elb/"
        "b_{}_wrist_twist b_{}_forearm elb~wri:0.7/b_{}_wrist b_{}_forearm wri/b_{}_index1 b_{}_wrist index/"
        "b_{}_middle1 b_{}_wrist knu/b_{}_middle2 b_{}_middle1 tip/b_{}_thumb0 b_{}_wrist thumb/"
        "b_{}_upleg b_root hip/b_{}_leg b_{}_upleg knee/b_{}_foot b_{}_leg ankle/b_{}_toe0 b_{}_foot ball",
        ("l", "r"),
    ),
    "rigify": Dialect(
        "root - floor/DEF-spine root root/DEF-spine.001 DEF-spine s0.25/DEF-spine.002 DEF-spine.001 s0.5/"
        "DEF-spine.003 DEF-spine.002 s0.75/DEF-spine.004 DEF-spine.003 neck/"
        "DEF-spine.005 DEF-spine.004 neck~head:0.5/DEF-spine.006 DEF-spine.005 head/"
        "DEF-spine.006_end DEF-spine.006 top/DEF-shoulder{} DEF-spine.003 clav/"
        "DEF-upper_arm{} DEF-shoulder{} sho/DEF-upper_arm{}.001 DEF-upper_arm{} sho~elb:0.5/"
        "DEF-forearm{} DEF-upper_arm{}.001 elb/DEF-forearm{}.001 DEF-forearm{} elb~wri:0.5/"
        "DEF-hand{} DEF-forearm{}.001 wri/DEF-hand{}_end DEF-hand{} knu/DEF-thigh{} DEF-spine hip/"
        "DEF-thigh{}.001 DEF-thigh{} hip~knee:0.5/DEF-shin{} DEF-thigh{}.001 knee/"
        "DEF-shin{}.001 DEF-shin{} knee~ankle:0.5/DEF-foot{} DEF-shin{}.001 ankle/DEF-toe{} DEF-foot{} ball/"
        "DEF-toe{}_end DEF-toe{} toe",
        (".L", ".R"),
    ),
    "vrm": Dialect(
        "Root - floor/J_Bip_C_Hips Root root/J_Bip_C_Spine J_Bip_C_Hips s0.2/J_Bip_C_Chest J_Bip_C_Spine s0.5/"
        "J_Bip_C_UpperChest J_Bip_C_Chest s0.75/J_Bip_C_Neck J_Bip_C_UpperChest neck/"
        "J_Bip_C_Head J_Bip_C_Neck head/J_Adj_{}_FaceEye J_Bip_C_Head eye/"
        "J_Bip_{}_Shoulder J_Bip_C_UpperChest clav/J_Bip_{}_UpperArm J_Bip_{}_Shoulder sho/"
        "J_Bip_{}_LowerArm J_Bip_{}_UpperArm elb/J_Bip_{}_Hand J_Bip_{}_LowerArm wri/"
        "J_Bip_{}_Middle1 J_Bip_{}_Hand knu/J_Sec_{}_Bust1 J_Bip_C_UpperChest clav/J_Sec_Hair1 J_Bip_C_Head top/"
        "J_Bip_{}_UpperLeg J_Bip_C_Hips hip/J_Sec_{}_CoatSkirtFront J_Bip_{}_UpperLeg hip~knee:0.6/"
        "J_Bip_{}_LowerLeg J_Bip_{}_UpperLeg knee/J_Bip_{}_Foot J_Bip_{}_LowerLeg ankle/"
        "J_Bip_{}_ToeBase J_Bip_{}_Foot ball",
        ("L", "R"),
    ),
    "arkit": Dialect(
        "root - floor/hips_joint root root/{}_upLeg_joint hips_joint hip/{}_leg_joint {}_upLeg_joint knee/"
        "{}_foot_joint {}_leg_joint ankle/{}_toes_joint {}_foot_joint ball/{}_toesEnd_joint {}_toes_joint toe/"
        "spine_1_joint hips_joint s0.1/spine_2_joint spine_1_joint s0.25/spine_3_joint spine_2_joint s0.4/"
        "spine_4_joint spine_3_joint s0.55/spine_5_joint spine_4_joint s0.7/spine_6_joint spine_5_joint s0.8/"
        "spine_7_joint spine_6_joint s0.9/neck_1_joint spine_7_joint neck/"
        "neck_2_joint neck_1_joint neck~head:0.3/neck_3_joint neck_2_joint neck~head:0.6/"
        "head_joint neck_3_joint head/{}_eye_joint head_joint eye/{}_shoulder_1_joint spine_7_joint clav/"
        "{}_arm_joint {}_shoulder_1_joint sho/{}_forearm_joint {}_arm_joint elb/"
        "{}_hand_joint {}_forearm_joint wri/{}_handMidStart_joint {}_hand_joint palm/"
        "{}_handMid_1_joint {}_handMidStart_joint knu",
        ("left", "right"),
    ),
    "motive": Dialect(
        "Bob_Hip - root/Bob_Ab Bob_Hip s0.3/Bob_Chest Bob_Ab s0.6/Bob_Neck Bob_Chest neck/Bob_Head Bob_Neck head/"
        "Bob_Head_end Bob_Head top/Bob_{}Shoulder Bob_Chest clav/Bob_{}UArm Bob_{}Shoulder sho/"
        "Bob_{}FArm Bob_{}UArm elb/Bob_{}Hand Bob_{}FArm wri/Bob_{}Hand_end Bob_{}Hand knu/"
        "Bob_{}Thigh Bob_Hip hip/Bob_{}Shin Bob_{}Thigh knee/Bob_{}Foot Bob_{}Shin ankle/"
        "Bob_{}Toe Bob_{}Foot ball/Bob_{}Toe_end Bob_{}Toe toe",
        ("L", "R"),
    ),
    "ipisoft": Dialect(
        "Hip - root/LowerSpine Hip s0.2/MiddleSpine LowerSpine s0.45/Chest MiddleSpine s0.7/Neck Chest neck/"
        "Head Neck head/{}Clavicle Chest clav/{}Shoulder {}Clavicle sho/{}Forearm {}Shoulder elb/"
        "{}Hand {}Forearm wri/{}Thigh Hip hip/{}Shin {}Thigh knee/{}Foot {}Shin ankle/{}Toe {}Foot ball",
        ("L", "R"),
    ),
    "second life": Dialect(
        "mPelvis - root/mTorso mPelvis s0.2/mChest mTorso s0.6/mNeck mChest neck/mHead mNeck head/"
        "mSkull mHead top/mCollar{} mChest clav/mShoulder{} mCollar{} sho/mElbow{} mShoulder{} elb/"
        "mWrist{} mElbow{} wri/mHip{} mPelvis hip/mKnee{} mHip{} knee/mAnkle{} mKnee{} ankle/"
        "mFoot{} mAnkle{} ball/mToe{} mFoot{} toe"
    ),
    "valve": Dialect(
        "ValveBiped.Bip01 - floor/ValveBiped.Bip01_Pelvis ValveBiped.Bip01 root/"
        "ValveBiped.Bip01_Spine ValveBiped.Bip01_Pelvis s0.2/"
        "ValveBiped.Bip01_Spine1 ValveBiped.Bip01_Spine s0.45/"
        "ValveBiped.Bip01_Spine2 ValveBiped.Bip01_Spine1 s0.65/"
        "ValveBiped.Bip01_Spine4 ValveBiped.Bip01_Spine2 s0.85/"
        "ValveBiped.Bip01_Neck1 ValveBiped.Bip01_Spine4 neck/ValveBiped.Bip01_Head1 ValveBiped.Bip01_Neck1 head/"
        "ValveBiped.Bip01{}Clavicle ValveBiped.Bip01_Spine4 clav/"
        "ValveBiped.Bip01{}UpperArm ValveBiped.Bip01{}Clavicle sho/"
        "ValveBiped.Bip01{}Forearm ValveBiped.Bip01{}UpperArm elb/"
        "ValveBiped.Bip01{}Hand ValveBiped.Bip01{}Forearm wri/"
        "ValveBiped.Bip01{}Thigh ValveBiped.Bip01_Pelvis hip/ValveBiped.Bip01{}Calf ValveBiped.Bip01{}Thigh knee/"
        "ValveBiped.Bip01{}Foot ValveBiped.Bip01{}Calf ankle/ValveBiped.Bip01{}Toe0 ValveBiped.Bip01{}Foot ball",
        ("_L_", "_R_"),
    ),
    "character creator": Dialect(
        "CC_Base_BoneRoot - floor/CC_Base_Hip CC_Base_BoneRoot root/CC_Base_Pelvis CC_Base_Hip root/"
        "CC_Base_Waist CC_Base_Hip s0.2/CC_Base_Spine01 CC_Base_Waist s0.4/CC_Base_Spine02 CC_Base_Spine01 s0.7/"
        "CC_Base_NeckTwist01 CC_Base_Spine02 neck/CC_Base_NeckTwist02 CC_Base_NeckTwist01 neck~head:0.5/"
        "CC_Base_Head CC_Base_NeckTwist02 head/CC_Base_{}_Clavicle CC_Base_Spine02 clav/"
        "CC_Base_{}_Upperarm CC_Base_{}_Clavicle sho/CC_Base_{}_UpperarmTwist01 CC_Base_{}_Upperarm sho~elb:0.4/"
        "CC_Base_{}_Forearm CC_Base_{}_Upperarm elb/CC_Base_{}_Hand CC_Base_{}_Forearm wri/"
        "CC_Base_{}_Mid1 CC_Base_{}_Hand knu/CC_Base_{}_Thigh CC_Base_Pelvis hip/"
        "CC_Base_{}_Calf CC_Base_{}_Thigh knee/CC_Base_{}_Foot CC_Base_{}_Calf ankle/"
        "CC_Base_{}_ToeBase CC_Base_{}_Foot ball",
        ("L", "R"),
    ),
    "mmd": Dialect(
        "center - root/upper_body center s0.1/upper_body2 upper_body s0.5/neck upper_body2 neck/head neck head/"
        "lower_body center root/shoulder{} upper_body2 clav/arm{} shoulder{} sho/elbow{} arm{} elb/"
        "wrist{} elbow{} wri/leg{} lower_body hip/knee{} leg{} knee/ankle{} knee{} ankle/toe{} ankle{} toe",
        ("_L", "_R"),
    ),
    "nameless": Dialect(
        "joint_1 - root/joint_2 joint_1 s0.3/joint_3 joint_2 s0.7/joint_4 joint_3 neck/joint_5 joint_4 head/"
        "joint_6 joint_5 top/joint_7{} joint_3 clav/joint_8{} joint_7{} sho/joint_9{} joint_8{} elb/"
        "joint_10{} joint_9{} wri/joint_11{} joint_10{} knu/joint_12{} joint_1 hip/joint_13{} joint_12{} knee/"
        "joint_14{} joint_13{} ankle/joint_15{} joint_14{} toe",
        ("", "0"),
    ),
}


def evidence_of(
    dialect: Dialect, frames: int = 16, turn: F64 | None = None, seed: int = 0
) -> tuple[Evidence, dict[str, F64]]:
    """Return a moving body in a dialect, and the true places (3, K) of its named joints.

    Parameters
    ----------
    dialect : Dialect
        Names and tree.
    frames : int
        K; the first is the rest pose.
    turn : float64 array (3, 3), optional
        Turns (or mirrors) the whole file.
    seed : int
        Of the motion.
    """
    names, parents, rest, codes = _nodes(dialect)
    random = np.random.default_rng(seed)
    angles = np.cumsum(random.normal(0, 0.08, (frames, len(names), 3)), axis=0)
    angles[0] = 0
    places = np.zeros((len(names), 3, frames))
    rotations = np.zeros((len(names), frames, 3, 3))
    for i, parent in enumerate(parents):
        own = _rotations(angles[:, i] * (0.3 if codes[i][1] in ("root", "floor") or codes[i][1][0] == "s" else 1.0))
        if parent < 0:
            rotations[i], places[i] = (
                own,
                rest[i][:, None] + np.cumsum(random.normal(0, 0.02, (3, frames)) * [[1], [0.1], [1]], 1),
            )
        else:
            rotations[i] = rotations[parent] @ own
            places[i] = places[parent] + (rotations[parent] @ (rest[i] - rest[parent])).T
    turn = np.eye(3) if turn is None else turn
    rest, places = rest @ turn.T, np.einsum("ab,ibk->iak", turn, places)
    truth = {
        side + JOINT_OF[code]: places[i]
        for i, (side, code) in enumerate(codes)
        if code in JOINT_OF and names[i][-4:] != "_end"
    }
    offsets = np.array([rest[i] - (rest[p] if p >= 0 else 0.0) for i, p in enumerate(parents)])
    return Evidence(tuple(names), places, tuple(parents), offsets), truth


def _nodes(dialect: Dialect) -> tuple[list[str], list[int], F64, list[tuple[str, str]]]:
    rows: list[tuple[str, str, str, str]] = []
    for line in dialect.lines.split("/"):
        name, parent, code = line.split(" ")
        both = list(zip("lr", dialect.sides, strict=True)) if "{}" in name + parent else [("", "")]
        rows += [(name.replace("{}", mark), parent.replace("{}", mark), side, code) for side, mark in both]
    order = _parents_first({name: parent for name, parent, _, _ in rows})
    by_name = {row[0]: row for row in rows}
    names = [by_name[name][0] for name in order]
    parents = [names.index(by_name[name][1]) if by_name[name][1] != "-" else -1 for name in order]
    codes = [
        (by_name[name][2] if by_name[name][3] not in ("root", "neck", "head") else "", by_name[name][3])
        for name in order
    ]
    rest = np.array([_place(by_name[name][3]) * [-1 if by_name[name][2] == "r" else 1, 1, 1] for name in order])
    return names, parents, rest, codes


def _parents_first(parents: Mapping[str, str]) -> list[str]:
    order: list[str] = []
    while len(order) < len(parents):
        order += [name for name, parent in parents.items() if name not in order and (parent == "-" or parent in order)]
    return order


def _place(code: str) -> F64:
    if "~" in code:
        ends, share = code.split(":")
        a, b = (_place(end) for end in ends.split("~"))
        return a + float(share) * (b - a)
    if code[0] == "s" and code[1:].replace(".", "").isdigit():
        return _place("root") + float(code[1:]) * (_place("neck") - _place("root"))
    return np.array(PLACES[code])


def _rotations(vectors: F64) -> F64:
    """Return the rotations (K, 3, 3) of rotation vectors (K, 3)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None] + 1e-12
    x, y, z = (vectors / angle[:, 0]).T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)
