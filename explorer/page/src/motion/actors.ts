// The motions on a stage, and what every stage does with them, whether it draws by WebGL or on a plain canvas.

import { type Body, facing } from "./body";
import { place } from "./bones";
import type { Motion } from "./motion";

/** A motion on the stage. */
export interface Actor {
  motion: Motion;
  /** Another tone, for the second of two takes. */
  second?: boolean;
  /** Where it stands instead of its own place: beside others, facing the camera in the frame `facing`. */
  stand?: { x: number; facing: number };
}

/** What shows the motion of a take, and lets a person turn it. */
export interface Staging {
  readonly canvas: HTMLCanvasElement;
  /** True if it draws lines, as the browser has no WebGL. */
  readonly flat: boolean;
  follow: boolean;
  trails: boolean;
  /** Called when somebody turns the camera: the picture has to be drawn again. */
  onView: () => void;
  /** Put motions on the stage in place of others. */
  setActors: (actors: readonly Actor[], body: Body) => void;
  /** Put the floor at a height, in metres. */
  setFloor: (height: number) => void;
  /** Fit the picture to its box, in CSS pixels. */
  resize: (width: number, height: number) => void;
  /** Draw a frame of each actor; returns whether the first of them is known there. */
  draw: (frames: readonly number[], body: Body) => boolean;
  /** Turn the camera about the body by an angle, and go closer (a factor below 1) or farther. */
  turn: (angle: number, distance?: number) => void;
  /** See the first figure from its front again. */
  reset: () => void;
}

/** Degrees from top to bottom of the picture. */
export const FIELD_OF_VIEW = 32;
/** Height of the point that the camera looks at, in metres. */
export const EYE_M = 0.95;
/** Nearest and farthest place of the camera, in metres. */
export const NEAREST = 0.8;
export const FARTHEST = 40;
/** Squares of the floor of one metre on each side of the body. */
export const SQUARES = 12;
/** The camera begins so far to the side of the direction that the body faces, in radians. */
export const ASIDE = 0.5;

export const TRAIL_POINTS = 40;
export const TRAIL_JOINTS = ["lwrist", "rwrist", "lankle", "rankle"];

/** Return the frames of a trail: the last second and the next half. */
export function trailFrames(frame: number, rateHz: number): number[] {
  const step = (1.5 * rateHz) / (TRAIL_POINTS - 1);
  return Array.from({ length: TRAIL_POINTS }, (_, k) => Math.max(0, frame - rateHz + k * step));
}

/** Reads the poses of an actor where it stands. */
export class ActorPoses {
  private readonly scratch: Float32Array;
  private yaw: number | null = null;

  constructor(
    readonly actor: Actor,
    private readonly body: Body,
  ) {
    this.scratch = new Float32Array(3 * body.joints.length);
  }

  /** Write the positions at a frame; false where they are not known. */
  read(frame: number, out: Float32Array): boolean {
    if (!this.actor.motion.pose(frame, out)) return false;
    const stand = this.actor.stand;
    if (stand === undefined) return true;
    if (this.yaw === null) {
      if (!this.actor.motion.pose(stand.facing, this.scratch)) return false;
      const yaw = facing(this.body, this.scratch);
      this.yaw = Number.isNaN(yaw) ? 0 : yaw;
    }
    const { root } = this.body;
    place(out, { x: out[3 * root] as number, z: out[3 * root + 2] as number, yaw: this.yaw }, stand.x);
    return true;
  }
}
