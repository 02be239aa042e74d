"""Words of the text formats, and what they nest, that mutants get where no valid file would have them."""

from __future__ import annotations

BVH_WORDS = (
    *(b"HIERARCHY", b"ROOT x", b"JOINT y", b"End Site", b"{", b"}", b"OFFSET 1 2 3", b"CHANNELS 3", b"MOTION"),
    *(b"CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation", b"Frames: 1", b"Frame Time: 1"),
    *(b"#", b"//", b"Xrotation", b"CHANNELS 0", b"CHANNELS 1e9"),
)
DEEP_BVH = (
    (b"JOINT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n", b"}\n"),
    (b"JOINT a\n{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n", b"}\n"),
    (b"{\n", b"}\n"),
    (b"End Site\n{\nOFFSET 0 0 0\n", b"}\n"),
)
ASF_WORDS = (
    *(b":units", b":root", b":bonedata", b":hierarchy", b":documentation", b"begin", b"end", b"dof rx ry rz l"),
    *(b"order RX RY", b"axis 0 0 0 ZYX", b"name root", b"name head", b"length 0", b"length 1e308", b"dof tx ty tz"),
    *(b"root head", b"head root", b"angle rad", b"direction 0 0 0", b"direction 1e200 1e200 0", b"limits (-1 1)"),
)
AMC_WORDS = (b"1", b"2", b"root 0 0 0 0 0 0", b":RADIANS", b":DEGREES", b"#", b"head 0 0 0", b"head", b"999999999")
YAML_WORDS = (
    *(
        b"&a ",
        b"*a",
        b"<<: *a",
        b"? ",
        b"- ",
        b"!!python/object:os.system ",
        b"!!binary ",
        b"!!float ",
        b"!!set ",
        b"|",
    ),
    *(b">", b"%YAML 9.9", b"---", b"...", b"null", b"on", b"2001-99-99", b"0o7", b"1:99", b"'", b'"', b'"\\ud800"'),
    *(b"{}", b"[]", b"? {a: b}", b"~: ~", b"\t", b".inf", b".nan", b"1e999", b"keyframes:", b"joints:", b"[1, 2]: 3"),
    *(b"!!timestamp x", b"!!int ''", b"!!omap [a]", b"!!pairs 3", b"=", b"!!bool x", b'"\\uFFFF"', b"!<tag:x> "),
)
DEEP_YAML = ((b"[", b"]"), (b"{a: ", b"}"), (b"- ", b""), (b"? ", b""), (b"&a [*a, ", b"]"), (b"!!seq [", b"]"))
CSV_WORDS = (b'"', b"root_x,root_y,root_z,", b"frame,", b"time,", b",,,,", b"nan,", b"take,class,start,stop", b'""')
MOTIVE_WORDS = (
    *(b"Format Version,", b"Length Units,Meters,", b"Coordinate Space,Global,", b"Bone,", b"Marker,", b"Position,"),
    *(b"Rotation,", b"Frame,Time (Seconds),X,Y,Z\n", b"TimeCode,", b",,", b"Ann:root,", b'"'),
)
NEXUS_WORDS = (
    *(b"Trajectories\n100\n", b"Model Outputs\n100\n", b"Devices\n", b"Frame,Sub Frame,X,Y,Z\n", b",,Ann:root,,,"),
    *(b",,mm,mm,mm", b"\n\n", b",,,\n", b"TX,TY,TZ", b"*11", b"Field #,", b"100,Hz\n"),
)
MOT_WORDS = (b"endheader\n", b"inDegrees=no\n", b"nan", b"time\t", b"pelvis_ty\t", b"/value")
OSIM_WORDS = (
    *(b"<coordinates>hip_r_q0</coordinates>", b"<axis>0 0 0</axis>", b"<Constant><value>1e5</value></Constant>"),
    *(b"<PolynomialFunction><coefficients>1 2 3</coefficients></PolynomialFunction>", b"<reverse>true</reverse>"),
    *(b"<MultiplierFunction/>", b"<LinearFunction/>", b"/bodyset/pelvis", b'name="pelvis"', b"<x>0 0 0</x>"),
    *(b"<!DOCTYPE a [<!ENTITY b 'cc'>]>", b"&b;", b"<![CDATA[", b"<!--", b"<Joint>", b"<FreeJoint>", b"<WeldJoint/>"),
)
QUALISYS_WORDS = (
    *(
        b"NO_OF_FRAMES\t",
        b"MARKER_NAMES\t",
        b"FREQUENCY\t100\n",
        b"BODY_NAMES\tbox\n",
        b"DATA_INCLUDED\t6D\n",
        b"NULL\t",
    ),
    *(b"TRAJECTORY_TYPES\tMeasured\n", b"Frame\tTime\t", b"0.000\t0.000\t0.000\t", b"\t\t\t"),
)
KEYPOINT_WORDS = (
    *(
        b'"frames":',
        b'"people":[',
        b'"instances":[',
        b'"keypoints":',
        b'"pose_keypoints_2d":[1,2,0.5],',
        b'"track_id":1,',
    ),
    *(b'"world_landmarks":', b'{"x":1,"y":2,"z":3},', b"null,", b"NaN,", b"-Infinity,", b"[],", b"{},", b'"fps":0,'),
    *(b'"timestamp_ms":5,', b'"names":["a","a"],', b"1e999,", b"9" * 400),
)

EAF_WORDS = (
    *(
        b"<!DOCTYPE a [<!ENTITY b 'cc'>]>",
        b"&b;",
        b"<![CDATA[",
        b"]]>",
        b"<!--",
        b"-->",
        b"<?x y?>",
        b"&#0;",
        b"&#xD800;",
    ),
    *(b'<!DOCTYPE a SYSTEM "file:///etc/passwd">', b"<TIER>", b'<TIER TIER_ID="x">', b"</TIER>", b"<ANNOTATION_VALUE>"),
    *(b'TIME_VALUE="9"', b'<?xml version="1.0" encoding="utf-7"?>', b'encoding="shift_jis"', b'PARENT_REF="walk"'),
)
DEEP_EAF = ((b"<TIER TIER_ID='x'>", b"</TIER>"), (b"<ANNOTATION_VALUE>", b"</ANNOTATION_VALUE>"), (b"<a>", b"</a>"))
MVNX_WORDS = (
    *(b"<!DOCTYPE a [<!ENTITY b 'cc'>]>", b"&b;", b"<![CDATA[", b"]]>", b"<!--", b"-->", b"&#0;", b'type="normal"'),
    *(b"<frames>", b"</frames>", b'<frame type="normal">', b"</frame>", b"<position>", b"</position>", b"<segments>"),
    *(b'<segment label="Pelvis">', b'<subject label="x">', b'<point label="pTopOfHead">', b"<pos_b>1 2 3</pos_b>"),
    *(b'frameRate="0"', b'frameRate="nan"', b'index="99999999999999999999"', b'encoding="utf-16"', b"1e999 "),
)
DEEP_MVNX = (
    (b"<segments><segment label='x'>", b"</segment></segments>"),
    (b"<frame type='normal'>", b"</frame>"),
    (b"<a>", b"</a>"),
)
GLTF_WORDS = (
    *(b'"byteStride": 4,', b'"byteOffset": 1,', b'"count": 1000000000,', b'"normalized": true,', b'"sparse": {},'),
    *(
        b'"uri": "../a.bin",',
        b'"uri": "data:;base64,AAAA",',
        b'"children": [0],',
        b'"children": [1, 2],',
        b'"joints": [1],',
    ),
    *(
        b'"matrix": [0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0],',
        b'"scale": [0, 0, 0],',
        b'"scale": [-1, 1, 1e9],',
        b"null",
        b"-1",
    ),
    *(b'"interpolation": "STEP",', b'"interpolation": "CUBICSPLINE",', b'"rotation": [0, 0, 0, 0],', b"1e999", b"NaN"),
    *(b'"extensions": {"VRM": {"humanoid": {"humanBones": [{"bone": "hips", "node": 1}]}}},', b'"name": "\\ud800",'),
)
FBX_WORDS = (
    *(b"Objects:  {", b"}", b"{", b"*3 {", b"a: 1,2,3", b"KeyTime: *2 {", b"*1000000000 {", b'C: "OO",1001,1002', b";"),
    *(b'P: "Lcl Rotation", "", "", "A",1e300,nan,0', b'P: "UnitScaleFactor", "", "", "",0', b'"', b"&quot;", b"1e999"),
    *(b'P: "UpAxis", "", "", "",7', b'P: "RotationOrder", "", "", "",99', b"FBXVersion: 6100", b"9999999999999999999"),
)
DEEP_FBX = ((b"a: {", b"}"), (b"Pose: 1 {", b"}"), (b'"', b'"'), (b";", b"\n"), (b"Objects: {", b"}"))
VTT_WORDS = (
    b"NOTE",
    b"STYLE",
    b"-->",
    b"00:00.000 --> 99:59:59.999",
    b"<b>",
    b"&lt;",
    b"&#xD800;",
    b"WEBVTT",
    b"\n\n",
)
JSON_WORDS = (
    b"{",
    b"}",
    b"[",
    b"]",
    b"NaN",
    b"-Infinity",
    b'"\\ud800"',
    b"1e999",
    b"null",
    b"true",
    b'"start": 1,',
    b"9" * 20,
)
