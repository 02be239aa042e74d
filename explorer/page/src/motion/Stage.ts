// The stage of the 3D player: a floor, figures on it, and a camera that a person turns and that follows the body.
// It draws when it is told to; who shows it decides about time. Nothing here is React's.

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  DynamicDrawUsage,
  Group,
  HemisphereLight,
  InstancedMesh,
  LineBasicMaterial,
  LineSegments,
  MeshBasicMaterial,
  MeshLambertMaterial,
  PerspectiveCamera,
  Scene,
  SphereGeometry,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import {
  type Actor,
  ActorPoses,
  ASIDE,
  EYE_M,
  FARTHEST,
  FIELD_OF_VIEW,
  NEAREST,
  SQUARES,
  type Staging,
  TRAIL_JOINTS,
  TRAIL_POINTS,
  trailFrames,
} from "./actors";
import { type Body, facing, makeBody } from "./body";
import { writeFigure } from "./bones";
import { type Colours, colours, onTheme } from "./colours";
import { FlatStage } from "./FlatStage";
import { Motion } from "./motion";

const BONE_RADIUS = 0.024;
const BALL_RADIUS = 0.032;

const NOBODY = makeBody([], []);

/** The materials of all figures. They are never disposed of: their programs, which take long to compile, go with the last. */
class Materials {
  readonly bone = new MeshLambertMaterial();
  readonly dark = new MeshBasicMaterial();
  readonly trail = new LineBasicMaterial({ vertexColors: true });
  readonly floor = new LineBasicMaterial();
}

/** The pieces of one actor. */
class Figure {
  readonly group = new Group();
  readonly pose: Float32Array;
  private readonly bones: InstancedMesh;
  private readonly balls: InstancedMesh;
  private readonly shadow: InstancedMesh;
  private readonly shade = new Group();
  private readonly trail: LineSegments;
  private readonly trailPlaces: Float32Array;
  private readonly trailJoints: number[];
  private readonly scratch: Float32Array;
  private readonly poses: ActorPoses;

  constructor(
    readonly actor: Actor,
    private readonly body: Body,
    materials: Materials,
  ) {
    this.poses = new ActorPoses(actor, body);
    const joints = body.joints.length;
    this.pose = new Float32Array(3 * joints);
    this.scratch = new Float32Array(3 * joints);
    const cylinder = new CylinderGeometry(BONE_RADIUS, BONE_RADIUS * 1.15, 1, 8, 1, true);
    this.bones = new InstancedMesh(cylinder, materials.bone, body.bones.length);
    this.balls = new InstancedMesh(new SphereGeometry(1, 12, 8), materials.bone, joints + 1);
    this.shadow = new InstancedMesh(cylinder, materials.dark, body.bones.length);
    for (const mesh of [this.bones, this.balls, this.shadow]) {
      mesh.frustumCulled = false;
      mesh.instanceMatrix.setUsage(DynamicDrawUsage);
    }
    this.shadow.instanceMatrix = this.bones.instanceMatrix;
    this.shade.scale.y = 1e-3;
    this.shade.position.y = 2e-3;
    this.shade.add(this.shadow);
    this.trailJoints = TRAIL_JOINTS.map((name) => body.joints.indexOf(name)).filter((joint) => joint >= 0);
    this.trailPlaces = new Float32Array(this.trailJoints.length * (TRAIL_POINTS - 1) * 6);
    const line = new BufferGeometry();
    line.setAttribute("position", new BufferAttribute(this.trailPlaces, 3).setUsage(DynamicDrawUsage));
    line.setAttribute("color", new BufferAttribute(new Float32Array(this.trailPlaces.length), 3));
    this.trail = new LineSegments(line, materials.trail);
    this.trail.frustumCulled = false;
    this.group.add(this.bones, this.balls, this.shade, this.trail);
  }

  paint(theme: Colours): void {
    const ground = new Color(theme.surface);
    const tone = (side: "left" | "right" | "middle") => {
      const colour = new Color(theme[side]);
      return this.actor.second === true ? colour.lerp(ground, 0.55) : colour;
    };
    const { bones, sides, joints } = this.body;
    bones.forEach(([, joint], i) => this.bones.setColorAt(i, tone(sides[joint] ?? "middle")));
    for (let j = 0; j <= joints.length; j++) this.balls.setColorAt(j, tone(sides[j] ?? "middle"));
    for (const mesh of [this.bones, this.balls]) if (mesh.instanceColor !== null) mesh.instanceColor.needsUpdate = true;
    const colour = this.trail.geometry.getAttribute("color") as BufferAttribute;
    this.trailJoints.forEach((joint, i) => {
      const { r, g, b } = tone(sides[joint] ?? "middle").lerp(ground, 0.35);
      for (let k = 0; k < 2 * (TRAIL_POINTS - 1); k++) colour.setXYZ(2 * (TRAIL_POINTS - 1) * i + k, r, g, b);
    });
    colour.needsUpdate = true;
  }

  /** Take the pose of a frame; false where it is not known, and the figure vanishes. */
  show(frame: number, trails: boolean, floor: number): boolean {
    const known = this.poses.read(frame, this.pose);
    this.group.visible = known;
    this.group.position.y = -floor;
    this.trail.visible = known && trails;
    if (!known) return false;
    writeFigure(
      this.body,
      this.pose,
      this.bones.instanceMatrix.array as Float32Array,
      this.balls.instanceMatrix.array as Float32Array,
      BALL_RADIUS,
    );
    this.bones.instanceMatrix.needsUpdate = true;
    this.balls.instanceMatrix.needsUpdate = true;
    if (trails) this.drawTrail(frame);
    this.shade.position.y = floor + 2e-3;
    return true;
  }

  /** Draw where hands and feet have been in the last second and will be in the next half. */
  private drawTrail(frame: number): void {
    const places = this.trailPlaces;
    places.fill(NaN);
    trailFrames(frame, this.actor.motion.rateHz).forEach((at, k) => {
      if (!this.poses.read(at, this.scratch)) return;
      this.trailJoints.forEach((joint, i) => {
        const base = 6 * (TRAIL_POINTS - 1) * i;
        for (let axis = 0; axis < 3; axis++) {
          const value = this.scratch[3 * joint + axis] as number;
          if (k < TRAIL_POINTS - 1) places[base + 6 * k + axis] = value;
          if (k > 0) places[base + 6 * (k - 1) + 3 + axis] = value;
        }
      });
    });
    for (let i = 0; i < places.length; i += 6)
      if (Number.isNaN((places[i] as number) + (places[i + 3] as number))) places.fill(0, i, i + 6);
    (this.trail.geometry.getAttribute("position") as BufferAttribute).needsUpdate = true;
  }

  dispose(): void {
    for (const mesh of [this.bones, this.balls, this.shadow]) {
      mesh.geometry.dispose();
      mesh.dispose();
    }
    this.trail.geometry.dispose();
  }
}

/** The stage by WebGL. */
class Stage implements Staging {
  follow = true;
  trails = false;
  onView: () => void = () => {};

  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.05, 200);
  private readonly controls: OrbitControls;
  private readonly target = new Vector3(0, EYE_M, 0);
  private readonly materials = new Materials();
  private figures: Figure[] = [];
  private readonly grid = new LineSegments(floorLines(), this.materials.floor);
  private floor = 0;
  private aimed = false;
  readonly flat = false;

  constructor(
    readonly canvas: HTMLCanvasElement,
    context: WebGL2RenderingContext,
  ) {
    canvas.setAttribute("role", "img");
    this.renderer = new WebGLRenderer({ canvas, context });
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(1, 3, 2);
    this.scene.add(new HemisphereLight(0xffffff, 0x8a8f98, 1.9), sun, this.grid);
    this.camera.position.set(0, 1.5, 4.6);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.maxPolarAngle = Math.PI * 0.55;
    this.controls.minDistance = NEAREST;
    this.controls.maxDistance = FARTHEST;
    this.controls.addEventListener("change", () => this.onView());
    onTheme(() => {
      this.paint();
      this.onView();
    });
    this.paint();
  }

  setActors(actors: readonly Actor[], body: Body): void {
    for (const figure of this.figures) {
      this.scene.remove(figure.group);
      figure.dispose();
    }
    this.figures = actors.map((actor) => new Figure(actor, body, this.materials));
    for (const figure of this.figures) {
      this.scene.add(figure.group);
      figure.paint(colours());
    }
    this.aimed = false;
  }

  setFloor(height: number): void {
    this.floor = height;
  }

  private paint(): void {
    const theme = colours();
    this.scene.background = new Color(theme.surface);
    this.materials.floor.color = new Color(theme.line);
    this.materials.dark.color = new Color(theme.line).lerp(new Color(theme.dark ? "#000000" : "#8a93a0"), 0.45);
    for (const figure of this.figures) figure.paint(theme);
  }

  resize(width: number, height: number): void {
    if (width < 1 || height < 1) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  draw(frames: readonly number[], body: Body): boolean {
    let shown = false;
    this.figures.forEach((figure, i) => {
      const known = figure.show(frames[i] ?? frames[0] ?? 0, this.trails, this.floor);
      if (i === 0) shown = known;
    });
    const first = this.figures[0];
    if (first !== undefined && shown) this.aim(first, body);
    this.renderer.render(this.scene, this.camera);
    return shown;
  }

  /** Let the camera follow the root, from the half side where the body faces it first. */
  private aim(figure: Figure, body: Body): void {
    const alone = figure.actor.stand === undefined;
    const x = alone ? (figure.pose[3 * body.root] as number) : 0;
    const z = alone ? (figure.pose[3 * body.root + 2] as number) : 0;
    if (Number.isNaN(x + z)) return;
    if (!this.aimed) {
      this.aimed = true;
      this.turnTo(alone ? facing(body, figure.pose) + ASIDE : 0.35, x, z);
    } else if (this.follow) this.shift(x - this.target.x, z - this.target.z);
    this.grid.position.set(Math.round(this.target.x), 0, Math.round(this.target.z));
  }

  private turnTo(yaw: number, x: number, z: number): void {
    const angle = Number.isNaN(yaw) ? 0 : yaw;
    const away = this.figures.length > 1 ? 5.2 : 4.4;
    this.target.set(x, EYE_M, z);
    this.camera.position.set(x + away * Math.sin(angle), EYE_M + 0.55, z + away * Math.cos(angle));
    this.controls.target.copy(this.target);
    this.controls.update();
  }

  private shift(dx: number, dz: number): void {
    if (dx === 0 && dz === 0) return;
    this.target.x += dx;
    this.target.z += dz;
    this.camera.position.x += dx;
    this.camera.position.z += dz;
    this.controls.target.x += dx;
    this.controls.target.z += dz;
    this.camera.lookAt(this.controls.target);
  }

  turn(angle: number, distance = 1): void {
    const { position } = this.camera;
    const { target, minDistance, maxDistance } = this.controls;
    const away = position.clone().sub(target).applyAxisAngle(this.camera.up, angle);
    away.setLength(Math.min(maxDistance, Math.max(minDistance, away.length() * distance)));
    position.copy(target).add(away);
    this.controls.update();
  }

  reset(): void {
    this.aimed = false;
  }
}

/** Return squares of one metre. Each side is a line: some renderers drop long lines that begin behind the camera. */
function floorLines(): BufferGeometry {
  const places: number[] = [];
  for (let k = -SQUARES; k <= SQUARES; k++)
    for (let part = -SQUARES; part < SQUARES; part++) places.push(k, 0, part, k, 0, part + 1, part, 0, k, part + 1, 0, k);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(places), 3));
  return geometry;
}

let idle: Staging | null = null;
let made = false;

/** Return a stage that nobody uses, or a new one: to set up WebGL takes longer than to open a take. */
export function borrowStage(): Staging {
  const stage = idle ?? newStage();
  idle = null;
  return stage;
}

/** Return a stage by WebGL, or one that draws lines where the browser has none. */
function newStage(): Staging {
  made = true;
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2", { antialias: true, powerPreference: "low-power" });
  return context === null ? new FlatStage() : new Stage(canvas, context);
}

/** Draw something on a stage before there is a take, in a moment in which nothing else is to be done: the first take then
 * need not wait until WebGL is there and has compiled its programs. */
export function prepareStage(): void {
  if (made) return;
  const stage = newStage();
  const body = makeBody(TRAIL_JOINTS, [-1, 0, 0, 0]);
  const motion = new Motion();
  const numbers = Int16Array.of(0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0);
  motion.add({ first: 0, step: 1, frames: 1, joints: 4, rateHz: 30, unit: 1, origin: [0, 0, 0], numbers });
  stage.setActors([{ motion }], body);
  stage.trails = true;
  stage.resize(300, 200);
  stage.draw([0], body);
  stage.trails = false;
  returnStage(stage);
}

/** Give a stage back; its canvas leaves the page. */
export function returnStage(stage: Staging): void {
  stage.setActors([], NOBODY);
  stage.onView = () => {};
  stage.canvas.remove();
  idle = stage;
}
