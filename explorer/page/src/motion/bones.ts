// Matrices of the pieces of a figure: cylinders along bones, balls at joints, and a head.

import type { Body } from "./body";

/** Metres. */
export const HEAD_RADIUS = 0.095;

/** A place on the ground and a turn about Y: where a body is moved from, so that it stands at the origin and faces +Z. */
export interface Placement {
  x: number;
  z: number;
  yaw: number;
}

/** Move a pose, so that a body of the placement stands above (x, 0) and faces +Z; heights stay. */
export function place(pose: Float32Array, from: Placement, x: number): void {
  const cos = Math.cos(-from.yaw);
  const sin = Math.sin(-from.yaw);
  for (let i = 0; i < pose.length; i += 3) {
    const dx = (pose[i] as number) - from.x;
    const dz = (pose[i + 2] as number) - from.z;
    pose[i] = cos * dx + sin * dz + x;
    pose[i + 2] = cos * dz - sin * dx;
  }
}

/** Write a matrix (16 numbers, by columns) that lays a cylinder of height 1 along Y between two joints of a pose. */
export function writeBone(out: Float32Array, at: number, pose: Float32Array, one: number, other: number): void {
  const x = pose[3 * one] as number;
  const y = pose[3 * one + 1] as number;
  const z = pose[3 * one + 2] as number;
  const dx = (pose[3 * other] as number) - x;
  const dy = (pose[3 * other + 1] as number) - y;
  const dz = (pose[3 * other + 2] as number) - z;
  const length = Math.hypot(dx, dy, dz);
  if (!(length > 1e-6)) {
    out.fill(0, at, at + 16); // an unknown joint, or two at one place
    return;
  }
  const [ux, uy, uz] = [dx / length, dy / length, dz / length];
  // a vector across the bone: with Z, unless the bone lies along it
  const flat = Math.hypot(ux, uy);
  const across = flat > 1e-3 ? [uy / flat, -ux / flat, 0] : [1, 0, 0];
  const [ax, ay, az] = across as [number, number, number];
  out[at] = ax;
  out[at + 1] = ay;
  out[at + 2] = az;
  out[at + 3] = 0;
  out[at + 4] = dx;
  out[at + 5] = dy;
  out[at + 6] = dz;
  out[at + 7] = 0;
  out[at + 8] = ay * uz - az * uy;
  out[at + 9] = az * ux - ax * uz;
  out[at + 10] = ax * uy - ay * ux;
  out[at + 11] = 0;
  out[at + 12] = x + dx / 2;
  out[at + 13] = y + dy / 2;
  out[at + 14] = z + dz / 2;
  out[at + 15] = 1;
}

/** Write a matrix that puts a ball of radius 1 at a place; nothing where it is unknown. */
export function writeBall(out: Float32Array, at: number, x: number, y: number, z: number, radius: number): void {
  out.fill(0, at, at + 16);
  if (Number.isNaN(x + y + z)) return;
  out[at] = out[at + 5] = out[at + 10] = radius;
  out[at + 12] = x;
  out[at + 13] = y;
  out[at + 14] = z;
  out[at + 15] = 1;
}

/** Write the matrices of all bones, and of the balls: one for each joint, and the head as the last one. */
export function writeFigure(body: Body, pose: Float32Array, bones: Float32Array, balls: Float32Array, ball: number): void {
  body.bones.forEach(([one, other], i) => writeBone(bones, 16 * i, pose, one, other));
  const count = body.joints.length;
  for (let j = 0; j < count; j++)
    writeBall(balls, 16 * j, pose[3 * j] as number, pose[3 * j + 1] as number, pose[3 * j + 2] as number, ball);
  const { head, headTop: top } = body;
  if (head < 0 || top < 0) {
    balls.fill(0, 16 * count, 16 * count + 16);
    return;
  }
  const middle = (axis: number) => 0.5 * ((pose[3 * head + axis] as number) + (pose[3 * top + axis] as number));
  writeBall(balls, 16 * count, middle(0), middle(1), middle(2), HEAD_RADIUS);
}
