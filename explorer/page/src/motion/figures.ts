// Figures for grids and walls: asked for together, kept for a while, and drawn by one animation loop.

import { postBytes } from "../api/client";
import type { Body } from "./body";
import { HEAD_RADIUS } from "./bones";
import { type Colours, colours, onTheme } from "./colours";
import { type Block, figurePose, readFigures } from "./motion";

export interface FigureItem {
  take_id: number;
  start: number;
  stop: number;
}

/** Most stored frames of a figure; of longer intervals the server sends fewer frames a second. */
export const FIGURE_FRAMES = 120;
const TOGETHER = 10; // so few that the first appear early: figures of many takes lie in many places of the store
const AT_ONCE = 3; // requests; the browser has six connections, and other questions need some
const KEPT = 600;
const PICTURE_MS = 30;
/** The longest time on the main thread that the figures of one picture may take. */
const MAX_MS = 5;

const kept = new Map<string, Promise<Block>>();
let asked: { item: FigureItem; done: (block: Block) => void; failed: (fault: unknown) => void }[] = [];

/** Return the key of a figure. The version belongs to it: a take that is ingested again can have another motion. */
export function figureKey({ take_id, start, stop }: FigureItem, version: number): string {
  return `${version}/${take_id}/${start}/${stop}`;
}

/** Return the motion of a figure. Questions of the same moment go to the server together. */
export function loadFigure(item: FigureItem, version: number): Promise<Block> {
  const key = figureKey(item, version);
  const known = kept.get(key);
  if (known !== undefined) {
    kept.delete(key);
    kept.set(key, known);
    return known;
  }
  const block = new Promise<Block>((done, failed) => {
    if (asked.length === 0) setTimeout(send, 15);
    asked.push({ item, done, failed });
  });
  block.catch(() => kept.delete(key));
  kept.set(key, block);
  if (kept.size > KEPT) kept.delete(kept.keys().next().value as string);
  return block;
}

// What was asked for last is in sight, so it is loaded first: the rest may have been scrolled away.
const waiting: (typeof asked)[] = [];
let loading = 0;

function send(): void {
  waiting.push(asked);
  asked = [];
  while (loading < AT_ONCE && waiting.length > 0) void sendSome();
}

async function sendSome(): Promise<void> {
  const latest = waiting[waiting.length - 1] ?? [];
  const some = latest.splice(0, TOGETHER);
  if (latest.length === 0) waiting.pop();
  loading++;
  try {
    const body = { items: some.map((one) => one.item), frames: FIGURE_FRAMES };
    const blocks = readFigures(await postBytes("/api/figures", body));
    some.forEach((one, i) => one.done(blocks[i] as Block));
  } catch (fault) {
    for (const one of some) one.failed(fault);
  }
  loading--;
  if (waiting.length > 0) void sendSome();
}

const TURN = 0.6; // radians from the front, so that left and right are apart

/** A figure on a canvas. Its body faces the viewer in its first frame. */
export class DrawnFigure {
  private readonly pen: CanvasRenderingContext2D;
  private readonly pose: Float32Array;
  private readonly points: Float32Array;
  private readonly bounds: readonly [number, number, number, number];
  private shownRow = -1;
  visible = false;

  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly body: Body,
    private readonly block: Block,
  ) {
    this.pen = canvas.getContext("2d") as CanvasRenderingContext2D;
    this.pose = new Float32Array(3 * block.joints);
    this.points = new Float32Array(2 * block.joints);
    this.bounds = this.measure();
  }

  /** Seconds of the whole figure. */
  get seconds(): number {
    return (this.block.frames * this.block.step) / this.block.rateHz;
  }

  /** Return the least and largest x and y of all frames as they are drawn, around the root in x. */
  private measure(): readonly [number, number, number, number] {
    let [left, right, bottom, top] = [-0.5, 0.5, 0, 1.6];
    for (let row = 0; row < this.block.frames; row += Math.max(1, this.block.frames >> 4)) {
      this.project(row);
      for (let j = 0; j < this.block.joints; j++) {
        const x = this.points[2 * j] as number;
        const y = this.points[2 * j + 1] as number;
        if (Number.isNaN(x)) continue;
        if (x < left) left = x;
        if (x > right) right = x;
        if (y < bottom) bottom = y;
        if (y > top) top = y;
      }
    }
    return [left, right, bottom, top];
  }

  /** Project a stored frame: x to the right and y up in metres, around the root of that frame. */
  private project(row: number): void {
    const { pose, points, body } = this;
    figurePose(this.block, row, pose);
    const cos = Math.cos(TURN);
    const sin = Math.sin(TURN);
    const known = (value: number | undefined) => (value === undefined || Number.isNaN(value) ? 0 : value);
    const rootX = known(pose[3 * body.root]);
    const rootZ = known(pose[3 * body.root + 2]);
    for (let j = 0; j < this.block.joints; j++) {
      const x = (pose[3 * j] as number) - rootX;
      const z = (pose[3 * j + 2] as number) - rootZ;
      points[2 * j] = x * cos + z * sin;
      points[2 * j + 1] = (pose[3 * j + 1] as number) - (z * cos - x * sin) * 0.18;
    }
  }

  /** Draw the pose at a share of the figure, from 0 to 1. */
  draw(share: number, force = false): void {
    const row = Math.min(this.block.frames - 1, Math.floor(share * this.block.frames));
    if (row === this.shownRow && !force) return;
    this.shownRow = row;
    this.project(row);
    this.paint(colours());
  }

  /** Draw the pose that is shown once more, such as in another theme. */
  again(): void {
    if (this.shownRow >= 0) this.paint(colours());
  }

  private paint(theme: Colours): void {
    const { pen, points, body } = this;
    const { width, height } = this.canvas;
    const [left, right, bottom, top] = this.bounds;
    const scale = Math.min((width * 0.92) / (right - left), (height * 0.9) / (top - bottom));
    const middle = width / 2 - ((left + right) / 2) * scale;
    const floor = height * 0.95 + bottom * scale;
    pen.clearRect(0, 0, width, height);
    pen.lineWidth = 1;
    pen.strokeStyle = theme.line;
    pen.beginPath();
    pen.moveTo(width * 0.06, floor);
    pen.lineTo(width * 0.94, floor);
    pen.stroke();
    pen.lineCap = "round";
    pen.lineWidth = Math.max(1.5, scale / 28);
    for (const side of ["right", "middle", "left"] as const) {
      pen.strokeStyle = theme[side];
      pen.beginPath();
      for (const [one, other] of body.bones) {
        if (body.sides[other] !== side) continue;
        const x = points[2 * one] as number;
        const u = points[2 * other] as number;
        if (Number.isNaN(x) || Number.isNaN(u)) continue;
        pen.moveTo(middle + x * scale, floor - (points[2 * one + 1] as number) * scale);
        pen.lineTo(middle + u * scale, floor - (points[2 * other + 1] as number) * scale);
      }
      pen.stroke();
    }
    this.paintHead(middle, floor, scale, theme);
  }

  private paintHead(middle: number, floor: number, scale: number, theme: Colours): void {
    const { head, headTop } = this.body;
    if (head < 0 || headTop < 0) return;
    const x = ((this.points[2 * head] as number) + (this.points[2 * headTop] as number)) / 2;
    const y = ((this.points[2 * head + 1] as number) + (this.points[2 * headTop + 1] as number)) / 2;
    if (Number.isNaN(x + y)) return;
    this.pen.fillStyle = theme.middle;
    this.pen.beginPath();
    this.pen.arc(middle + x * scale, floor - y * scale, HEAD_RADIUS * scale, 0, 2 * Math.PI);
    this.pen.fill();
  }
}

// One loop draws all figures that are on the screen and move.

const moving = new Map<DrawnFigure, number>(); // figure → moment of its start
let running = 0;
let lastPicture = 0;

/** Let a figure move until `rest`. */
export function move(figure: DrawnFigure): void {
  moving.set(figure, performance.now());
  if (running === 0) running = requestAnimationFrame(picture);
}

/** Let a figure rest. */
export function rest(figure: DrawnFigure): void {
  moving.delete(figure);
}

function picture(now: number): void {
  running = moving.size > 0 ? requestAnimationFrame(picture) : 0;
  if (now - lastPicture < PICTURE_MS) return;
  lastPicture = now;
  const begun = performance.now();
  for (const [figure, start] of [...moving]) {
    if (performance.now() - begun > MAX_MS) return; // the rest come first in the next picture
    if (!figure.visible) continue;
    figure.draw((((now - start) / 1000) % figure.seconds) / figure.seconds);
    moving.delete(figure);
    moving.set(figure, start);
  }
}

const placed = new WeakMap<Element, DrawnFigure>();
const seen =
  typeof IntersectionObserver === "undefined"
    ? null
    : new IntersectionObserver((entries) => {
        for (const entry of entries) {
          const figure = placed.get(entry.target);
          if (figure !== undefined) figure.visible = entry.isIntersecting;
        }
      });

/** Know of a figure whether it is on the screen, and draw it again in another theme; returns a function that ends that. */
export function watch(figure: DrawnFigure): () => void {
  placed.set(figure.canvas, figure);
  seen?.observe(figure.canvas);
  const end = onTheme(() => figure.again());
  return () => {
    end();
    rest(figure);
    seen?.unobserve(figure.canvas);
    placed.delete(figure.canvas);
  };
}
