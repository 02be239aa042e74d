"""Read motion files (Acclaim, BVH, C3D, AMASS, joint positions) as bodies, and write them from takes.

`reader` defines what each reader offers and returns, and `reader_table` finds the reader of a file. Each format has a
module of its name with its reader; a format that is long to parse has further ones that begin with its name. Readers
of the same kind of motion share modules:

- channels of a skeleton's joints (`acclaim`, `bvh`): `text_blocks` reads the text, `mapped_body` makes the body;
- points, such as joints and markers (`c3d`, `positions`, `motive`, `nexus`, `qualisys`, `keypoint_json`,
  `pickled_keypoints`, `humanml`): `points` makes the body, `subjects` tells persons apart, `position_tables` reads
  text;
- figures whose nodes move (`fbx`, `gltf`, `mvnx`, `opensim`): `figures` makes the body, `scene_figures` chooses among
  several figures and clips;
- angles of a body model (`amass`): `body_models` has the body, `numpy_arrays` reads the arrays safely.
"""
