// A camera that looks at a point of a scene, as the camera of the 3D stage does: places in metres become pixels.

import { FARTHEST, FIELD_OF_VIEW, NEAREST } from "./actors";

/** Lowest and highest turn above the floor, in radians. */
const LOWEST = -0.05 * Math.PI;
const HIGHEST = 0.49 * Math.PI;
/** What is nearer than this is not drawn. */
export const NEAR = 0.05;

export class FlatCamera {
  /** The point that it looks at. */
  target: [number, number, number] = [0, 0, 0];
  /** Turn about Y from +Z towards +X, and above the floor. */
  yaw = 0;
  pitch = 0.12;
  distance = 4.4;
  width = 1;
  height = 1;
  private right: readonly [number, number] = [1, 0];
  private eye: readonly [number, number, number] = [0, 0, 1];
  private scale = 1;

  turn(yaw: number, pitch: number, distance = 1): void {
    this.yaw += yaw;
    this.pitch = Math.min(HIGHEST, Math.max(LOWEST, this.pitch + pitch));
    this.distance = Math.min(FARTHEST, Math.max(NEAREST, this.distance * distance));
  }

  /** Prepare `project` after something has changed. */
  aim(): void {
    const [sin, cos] = [Math.sin(this.yaw), Math.cos(this.yaw)];
    const level = this.distance * Math.cos(this.pitch);
    const [x, y, z] = this.target;
    this.right = [cos, -sin];
    this.eye = [x + level * sin, y + this.distance * Math.sin(this.pitch), z + level * cos];
    this.scale = this.height / 2 / Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
  }

  /** Write x and y in pixels and the depth in metres of a place; the depth is below `NEAR` behind the camera. */
  project(x: number, y: number, z: number, out: Float32Array, at: number): void {
    const [dx, dy, dz] = [x - this.eye[0], y - this.eye[1], z - this.eye[2]];
    const across = dx * this.right[0] + dz * this.right[1];
    // forwards along the floor, then tilted
    const along = dx * this.right[1] - dz * this.right[0];
    const [sin, cos] = [Math.sin(this.pitch), Math.cos(this.pitch)];
    const depth = along * cos - dy * sin;
    const up = dy * cos + along * sin;
    out[at] = this.width / 2 + (this.scale * across) / depth;
    out[at + 1] = this.height / 2 - (this.scale * up) / depth;
    out[at + 2] = depth;
  }

  /** Return the pixels of a length at a depth, in metres. */
  pixels(metres: number, depth: number): number {
    return (this.scale * metres) / depth;
  }
}
