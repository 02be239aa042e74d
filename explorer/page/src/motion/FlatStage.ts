// The stage on a plain canvas, for browsers without WebGL: lines for bones, the farther first. Drag turns the camera, the
// wheel or two fingers go closer.

import { ActorPoses, type Actor, ASIDE, EYE_M, SQUARES, type Staging, TRAIL_JOINTS, TRAIL_POINTS, trailFrames } from "./actors";
import { type Body, facing, type Side } from "./body";
import { HEAD_RADIUS } from "./bones";
import { type Colours, colours, onTheme } from "./colours";
import { FlatCamera, NEAR } from "./flatCamera";

const BONE_M = 0.05;
/** Radians of a turn by one pixel. */
const TURN = 0.008;

export class FlatStage implements Staging {
  follow = true;
  trails = false;
  onView: () => void = () => {};
  readonly flat = true;
  readonly canvas = document.createElement("canvas");
  private readonly camera = new FlatCamera();
  private readonly pen: CanvasRenderingContext2D;
  private actors: ActorPoses[] = [];
  private pose = new Float32Array(0);
  private points = new Float32Array(0);
  private floor = 0;
  private aimed = false;
  private dense = 1;

  constructor() {
    this.canvas.setAttribute("role", "img");
    this.pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;
    this.listen();
    onTheme(() => this.onView());
  }

  setActors(actors: readonly Actor[], body: Body): void {
    this.actors = actors.map((actor) => new ActorPoses(actor, body));
    this.pose = new Float32Array(3 * body.joints.length);
    this.points = new Float32Array(3 * body.joints.length);
    this.aimed = false;
  }

  setFloor(height: number): void {
    this.floor = height;
  }

  resize(width: number, height: number): void {
    if (width < 1 || height < 1) return;
    this.dense = Math.min(2, window.devicePixelRatio || 1);
    this.canvas.width = Math.round(width * this.dense);
    this.canvas.height = Math.round(height * this.dense);
    this.camera.width = width;
    this.camera.height = height;
  }

  draw(frames: readonly number[], body: Body): boolean {
    const { pen, camera } = this;
    const theme = colours();
    pen.setTransform(this.dense, 0, 0, this.dense, 0, 0);
    pen.fillStyle = theme.surface;
    pen.fillRect(0, 0, camera.width, camera.height);
    pen.lineCap = "round";
    const shown = this.actors[0]?.read(frames[0] ?? 0, this.pose) === true;
    if (shown) this.look(body);
    camera.aim();
    this.drawFloor(theme);
    this.actors.forEach((actor, i) => {
      const frame = frames[i] ?? frames[0] ?? 0;
      if (!actor.read(frame, this.pose)) return;
      pen.globalAlpha = actor.actor.second === true ? 0.5 : 1;
      if (this.trails) this.drawTrails(actor, frame, body, theme);
      actor.read(frame, this.pose);
      this.drawFigure(body, theme);
    });
    pen.globalAlpha = 1;
    return shown;
  }

  turn(angle: number, distance = 1): void {
    this.camera.turn(angle, 0, distance);
    this.onView();
  }

  reset(): void {
    this.aimed = false;
  }

  /** Let the camera look at the first figure, from the half side where it faces it first. */
  private look(body: Body): void {
    const alone = this.actors[0]?.actor.stand === undefined;
    const x = alone ? (this.pose[3 * body.root] as number) : 0;
    const z = alone ? (this.pose[3 * body.root + 2] as number) : 0;
    if (Number.isNaN(x + z)) return;
    if (!this.aimed) {
      const yaw = alone ? facing(body, this.pose) + ASIDE : 0.35;
      this.aimed = true;
      this.camera.yaw = Number.isNaN(yaw) ? 0 : yaw;
      this.camera.pitch = 0.12;
      this.camera.distance = this.actors.length > 1 ? 5.2 : 4.4;
    } else if (!this.follow) return;
    this.camera.target = [x, EYE_M, z];
  }

  private drawFloor(theme: Colours): void {
    const [x, , z] = this.camera.target;
    const [middleX, middleZ] = [Math.round(x), Math.round(z)];
    this.pen.strokeStyle = theme.line;
    this.pen.lineWidth = 1;
    for (let k = -SQUARES; k <= SQUARES; k++)
      for (let part = -SQUARES; part < SQUARES; part++) {
        this.line([middleX + k, 0, middleZ + part], [middleX + k, 0, middleZ + part + 1]);
        this.line([middleX + part, 0, middleZ + k], [middleX + part + 1, 0, middleZ + k]);
      }
  }

  /** Draw a line between two places in front of the camera. */
  private line(one: readonly [number, number, number], other: readonly [number, number, number]): void {
    const ends = new Float32Array(6);
    this.camera.project(...one, ends, 0);
    this.camera.project(...other, ends, 3);
    this.stroke(ends, 0, 1);
  }

  private stroke(points: Float32Array, one: number, other: number): void {
    if (!((points[3 * one + 2] as number) > NEAR && (points[3 * other + 2] as number) > NEAR)) return;
    this.pen.beginPath();
    this.pen.moveTo(points[3 * one] as number, points[3 * one + 1] as number);
    this.pen.lineTo(points[3 * other] as number, points[3 * other + 1] as number);
    this.pen.stroke();
  }

  private drawFigure(body: Body, theme: Colours): void {
    const { pen, pose, points, camera } = this;
    const colour = (joint: number) => theme[(body.sides[joint] ?? "middle") as Side];
    pen.strokeStyle = theme.line;
    const count = body.joints.length;
    // the shadow: the figure on the floor
    for (let j = 0; j < count; j++) camera.project(pose[3 * j] as number, 0, pose[3 * j + 2] as number, points, 3 * j);
    pen.lineWidth = 3;
    for (const [one, other] of body.bones) this.stroke(points, one, other);
    for (let j = 0; j < count; j++)
      camera.project(pose[3 * j] as number, (pose[3 * j + 1] as number) - this.floor, pose[3 * j + 2] as number, points, 3 * j);
    const depth = ([one, other]: readonly [number, number]) => (points[3 * one + 2] as number) + (points[3 * other + 2] as number);
    for (const bone of [...body.bones].sort((a, b) => depth(b) - depth(a))) {
      pen.strokeStyle = colour(bone[1]);
      pen.lineWidth = Math.max(1.5, camera.pixels(BONE_M, depth(bone) / 2));
      this.stroke(points, ...bone);
    }
    const { head, headTop: top } = body;
    if (head < 0 || top < 0) return;
    const middle = (axis: number) => 0.5 * ((points[3 * head + axis] as number) + (points[3 * top + axis] as number));
    if (!(middle(2) > NEAR)) return;
    pen.fillStyle = theme.middle;
    pen.beginPath();
    pen.arc(middle(0), middle(1), camera.pixels(HEAD_RADIUS, middle(2)), 0, 2 * Math.PI);
    pen.fill();
  }

  /** Draw where hands and feet have been in the last second and will be in the next half. */
  private drawTrails(actor: ActorPoses, frame: number, body: Body, theme: Colours): void {
    const joints = TRAIL_JOINTS.map((name) => body.joints.indexOf(name)).filter((joint) => joint >= 0);
    const places = joints.map(() => new Float32Array(3 * TRAIL_POINTS).fill(NaN));
    trailFrames(frame, actor.actor.motion.rateHz).forEach((at, k) => {
      if (!actor.read(at, this.pose)) return;
      joints.forEach((joint, i) => {
        const [x, y, z] = [0, 1, 2].map((axis) => this.pose[3 * joint + axis] as number) as [number, number, number];
        this.camera.project(x, y - this.floor, z, places[i] as Float32Array, 3 * k);
      });
    });
    this.pen.lineWidth = 1;
    joints.forEach((joint, i) => {
      this.pen.strokeStyle = theme[(body.sides[joint] ?? "middle") as Side];
      for (let k = 1; k < TRAIL_POINTS; k++) this.stroke(places[i] as Float32Array, k - 1, k);
    });
  }

  /** Turn by a drag; go closer by the wheel, or by two fingers. */
  private listen(): void {
    const { canvas, camera } = this;
    const held = new Map<number, [number, number]>();
    const spread = () => {
      const [one, other] = [...held.values()];
      return one === undefined || other === undefined ? 0 : Math.hypot(one[0] - other[0], one[1] - other[1]);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (before === undefined) return;
      const apart = spread();
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (held.size === 1) camera.turn(TURN * (before[0] - event.clientX), TURN * (event.clientY - before[1]));
      else if (apart > 0) camera.turn(0, 0, apart / Math.max(1, spread()));
      this.onView();
    });
    for (const end of ["pointerup", "pointercancel"] as const)
      canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        camera.turn(0, 0, Math.exp(event.deltaY * (event.deltaMode === 1 ? 16 : 1) * 0.001));
        this.onView();
      },
      { passive: false },
    );
  }
}
