// The body of a motion: joints, bones and sides, and the direction that it faces.

export type Side = "left" | "right" | "middle";

export interface Body {
  joints: readonly string[];
  /** For each joint the one that it hangs from, −1 for none. */
  parents: readonly number[];
  sides: readonly Side[];
  /** Pairs of joints. */
  bones: readonly (readonly [number, number])[];
  root: number;
  leftHip: number;
  rightHip: number;
  head: number;
  headTop: number;
}

export function makeBody(joints: readonly string[], parents: readonly number[]): Body {
  const bones: [number, number][] = [];
  parents.forEach((parent, joint) => {
    if (parent >= 0) bones.push([parent, joint]);
  });
  return {
    joints,
    parents,
    sides: joints.map(sideOf),
    bones,
    root: Math.max(0, joints.indexOf("root")),
    leftHip: joints.indexOf("lhip"),
    rightHip: joints.indexOf("rhip"),
    head: joints.indexOf("head"),
    headTop: joints.indexOf("headtop"),
  };
}

/** Return the side of a joint or a feature by the first letter of its name. */
export function sideOf(name: string): Side {
  if (name === "root") return "middle";
  return name.startsWith("l") ? "left" : name.startsWith("r") ? "right" : "middle";
}

/** Return the turn about Y from +Z towards +X of a body in a pose; NaN where its hips are unknown. */
export function facing(body: Body, pose: Float32Array): number {
  const { leftHip, rightHip } = body;
  if (leftHip < 0 || rightHip < 0) return NaN;
  const x = (pose[3 * leftHip] as number) - (pose[3 * rightHip] as number);
  const z = (pose[3 * leftHip + 2] as number) - (pose[3 * rightHip + 2] as number);
  return x === 0 && z === 0 ? NaN : Math.atan2(-z, x);
}
