// The picture of the map: points by WebGL, and above them what is drawn by hand: outlines and names of clusters, the
// lasso, the point under the pointer. It draws when it is told to, at most once a picture, and fewer of many points while
// the map moves. Nothing here is React's.

import { BufferAttribute, BufferGeometry, Camera, Color, DynamicDrawUsage, Points, Scene, ShaderMaterial, Vector2, WebGLRenderer } from "three";

import { type Colours, colours, onTheme } from "../motion/colours";
import { type ArchiveMap, type Legend, NO_FIT, ownFeature, type Point } from "./map";
import { PLENTY, pointsInSight } from "./mapDetail";
import { SHAPES } from "./MapSign";

/** What of the map is in sight: its middle, and how many times larger it is than the whole. */
export interface Look {
  x: number;
  y: number;
  zoom: number;
}

export const WHOLE: Look = { x: 0, y: 0, zoom: 1 };
export const MAX_ZOOM = 200;

const VERTEX = `
  attribute vec3 tint;
  attribute vec2 sign;
  uniform vec2 middle;
  uniform vec2 scale;
  uniform float size;
  varying vec3 colour;
  varying float shape;
  varying float opacity;
  void main() {
    gl_Position = vec4((position.xy - middle) * scale, 0.0, 1.0);
    colour = tint;
    shape = sign.x;
    opacity = sign.y;
    gl_PointSize = size * (shape < 0.0 ? 0.6 : 1.0);
  }`;

const FRAGMENT = `
  varying vec3 colour;
  varying float shape;
  varying float opacity;
  void main() {
    vec2 p = 2.0 * gl_PointCoord - 1.0;
    vec2 a = abs(p);
    float t = (p.y + 0.9) / 1.7;
    vec2 d = abs(vec2(p.x + p.y, p.x - p.y)) * 0.7071;
    bool on = length(p) < 0.85;
    if (shape > 4.5) on = min(d.x, d.y) < 0.28 && max(d.x, d.y) < 1.0;
    else if (shape > 3.5) on = min(a.x, a.y) < 0.28 && max(a.x, a.y) < 0.95;
    else if (shape > 2.5) on = t > 0.0 && t < 1.0 && a.x < t;
    else if (shape > 1.5) on = a.x + a.y < 1.0;
    else if (shape > 0.5) on = max(a.x, a.y) < 0.75;
    if (!on) discard;
    gl_FragColor = vec4(colour, opacity);
  }`;

const FAINT = 0.16;
const FULL = 0.85;
const NAME_FONT = "600 12px system-ui, sans-serif";
/** Most names of clusters; the rest have an outline, and a row of the table. */
const MAX_NAMES = 40;

export class MapPicture {
  look: Look = WHOLE;
  /** The corners of the lasso in pixels while it is drawn. */
  lasso: Point[] = [];
  /** The point that keys move, and the one under the pointer; −1 for none. */
  active = -1;
  pointed = -1;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new Camera();
  private readonly geometry = new BufferGeometry();
  private readonly material: ShaderMaterial;
  private readonly pen: CanvasRenderingContext2D;
  private readonly endTheme: () => void;
  private map: ArchiveMap | null = null;
  private legend: Legend | null = null;
  private chosen: ReadonlySet<number> = new Set();
  private xs = new Float32Array();
  private ys = new Float32Array();
  /** The points in the order in which they are drawn, and the index of those that a picture has. */
  private order = new Uint32Array();
  private drawn = new BufferAttribute(this.order, 1);
  private asked = 0;
  private stale = true;
  private moving = false;
  private width = 1;
  private height = 1;
  /** How far points are from the middle, at most. */
  private reach: Point = [1, 1];

  constructor(
    canvas: HTMLCanvasElement,
    private readonly above: HTMLCanvasElement,
  ) {
    this.renderer = new WebGLRenderer({ canvas, alpha: true, antialias: false });
    this.pen = above.getContext("2d") as CanvasRenderingContext2D;
    this.material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: { middle: { value: new Vector2() }, scale: { value: new Vector2() }, size: { value: 6 } },
      transparent: true,
      depthTest: false,
      depthWrite: false,
    });
    const points = new Points(this.geometry, this.material);
    points.frustumCulled = false;
    this.scene.add(points);
    this.endTheme = onTheme(() => {
      this.paint();
      this.draw();
    });
  }

  end(): void {
    cancelAnimationFrame(this.asked);
    this.endTheme();
    this.geometry.dispose();
    this.material.dispose();
    this.renderer.dispose();
  }

  resize(width: number, height: number): void {
    const dense = Math.min(2, window.devicePixelRatio || 1);
    [this.width, this.height] = [Math.max(1, width), Math.max(1, height)];
    this.renderer.setPixelRatio(dense);
    this.renderer.setSize(this.width, this.height, false);
    this.above.width = Math.round(this.width * dense);
    this.above.height = Math.round(this.height * dense);
    this.pen.setTransform(dense, 0, 0, dense, 0, 0);
    this.draw();
  }

  show(map: ArchiveMap, legend: Legend, chosen: ReadonlySet<number>): void {
    if (map !== this.map) {
      [this.xs, this.ys] = [Float32Array.from(map.x), Float32Array.from(map.y)];
      const places = new Float32Array(3 * map.x.length);
      for (let i = 0; i < map.x.length; i++) {
        places[3 * i] = this.xs[i] as number;
        places[3 * i + 1] = this.ys[i] as number;
      }
      this.geometry.setAttribute("position", new BufferAttribute(places, 3));
      const farthest = (values: readonly number[]) => values.reduce((most, one) => Math.max(most, Math.abs(one)), 0.05);
      this.reach = [farthest(map.x), farthest(map.y)];
    }
    [this.map, this.legend, this.chosen] = [map, legend, chosen];
    this.paint();
    this.draw();
  }

  /** Pixels of one unit of the map. */
  get scale(): number {
    return 0.45 * Math.min(this.width / this.reach[0], this.height / this.reach[1]) * this.look.zoom;
  }

  onScreen(point: number): Point {
    const { x, y } = this.look;
    const map = this.map as ArchiveMap;
    return this.toScreen([map.x[point] as number, map.y[point] as number], x, y);
  }

  private toScreen([x, y]: Point, atX = this.look.x, atY = this.look.y): Point {
    return [this.width / 2 + (x - atX) * this.scale, this.height / 2 - (y - atY) * this.scale];
  }

  /** Return the place of the map at a pixel. */
  onMap([u, v]: Point): Point {
    return [this.look.x + (u - this.width / 2) / this.scale, this.look.y - (v - this.height / 2) / this.scale];
  }

  /** Return what is in sight after zooming by a factor around a pixel, which stays where it is. */
  zoomed(factor: number, at: Point): Look {
    const zoom = Math.min(MAX_ZOOM, Math.max(0.5, this.look.zoom * factor));
    const [x, y] = this.onMap(at);
    const share = this.look.zoom / zoom;
    return { x: x + (this.look.x - x) * share, y: y + (this.look.y - y) * share, zoom };
  }

  /** Write the colours and signs of all points; those that do not fit the filters are drawn first. */
  private paint(): void {
    const { map, legend, chosen } = this;
    if (map === null || legend === null) return;
    const theme = colours();
    const count = map.x.length;
    const tints = new Float32Array(3 * count);
    const signs = new Float32Array(2 * count);
    const known = legend.labels.map((_, i) => new Color(theme.classes[i % theme.classes.length]).convertLinearToSRGB());
    const plain = new Color(theme.muted).convertLinearToSRGB();
    const order = new Uint32Array(count);
    let [first, last] = [0, count];
    for (let i = 0; i < count; i++) {
      const code = legend.codes[i] as number;
      const { r, g, b } = known[code] ?? plain;
      tints.set([r, g, b], 3 * i);
      const faint = code === NO_FIT || (chosen.size > 0 && !chosen.has(i));
      signs[2 * i] = code < 0 ? -1 : code % SHAPES.length;
      signs[2 * i + 1] = faint ? FAINT : FULL;
      order[faint || code < 0 ? first++ : --last] = i;
    }
    this.geometry.setAttribute("tint", new BufferAttribute(tints, 3));
    this.geometry.setAttribute("sign", new BufferAttribute(signs, 2));
    this.order = order;
    this.drawn = new BufferAttribute(new Uint32Array(count), 1).setUsage(DynamicDrawUsage);
    this.geometry.setIndex(this.drawn);
  }

  /** Show another part of the map, until `rest` with fewer points where many are in sight. */
  move(look: Look): void {
    this.look = look;
    this.moving = true;
    this.draw();
  }

  /** Show all points again. */
  rest(): void {
    if (!this.moving) return;
    this.moving = false;
    this.draw();
  }

  /** Draw with the next picture: all, or only what lies above the points, which cost far more. */
  draw(points = true): void {
    this.stale ||= points;
    if (this.asked === 0) this.asked = requestAnimationFrame(() => this.drawNow());
  }

  private drawNow(): void {
    this.asked = 0;
    const { material, look, map } = this;
    const few = map === null ? 1 : Math.min(1, Math.max(0.45, 60 / Math.sqrt(map.x.length + 1)));
    const size = Math.min(13, 9 * few * look.zoom ** 0.3);
    material.uniforms.middle?.value.set(look.x, look.y);
    material.uniforms.scale?.value.set((2 * this.scale) / this.width, (2 * this.scale) / this.height);
    if (material.uniforms.size !== undefined) material.uniforms.size.value = size * this.renderer.getPixelRatio();
    if (map !== null && this.stale) {
      this.choosePoints(size);
      this.renderer.render(this.scene, this.camera);
    }
    this.stale = false;
    this.drawAbove(colours(), size);
  }

  /** Put the points of this picture into the index. */
  private choosePoints(size: number): void {
    const { drawn, look, order, scale, xs, ys } = this;
    const into = drawn.array as Uint32Array;
    const reach: Point = [(this.width / 2 + size) / scale, (this.height / 2 + size) / scale];
    const choose = (cell: number | null) => pointsInSight(order, xs, ys, { ...look, reach }, cell, into);
    let first = choose(null);
    if (this.moving && into.length - first > PLENTY) first = choose(size / 2 / scale);
    drawn.clearUpdateRanges();
    drawn.addUpdateRange(first, into.length - first);
    drawn.needsUpdate = true;
    this.geometry.setDrawRange(first, into.length - first);
  }

  private drawAbove(theme: Colours, size: number): void {
    const { pen, map } = this;
    pen.clearRect(0, 0, this.width, this.height);
    if (map === null) return;
    this.drawClusters(map, theme);
    pen.lineWidth = 2;
    pen.strokeStyle = theme.text;
    for (const point of new Set([this.active, this.pointed])) {
      if (point < 0) continue;
      const [x, y] = this.onScreen(point);
      pen.beginPath();
      pen.arc(x, y, size / 2 + (point === this.active ? 6 : 3), 0, 2 * Math.PI);
      pen.stroke();
    }
    if (this.lasso.length > 1) {
      this.trace(this.lasso);
      pen.setLineDash([5, 4]);
      pen.stroke();
      pen.setLineDash([]);
    }
  }

  private drawClusters(map: ArchiveMap, theme: Colours): void {
    const { pen } = this;
    pen.lineWidth = 1;
    pen.strokeStyle = theme.muted;
    pen.globalAlpha = 0.55;
    for (const one of map.clusters) {
      this.trace(one.outline.map((corner) => this.toScreen(corner)));
      pen.stroke();
    }
    pen.globalAlpha = 1;
    pen.font = NAME_FONT;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const taken: [number, number, number, number][] = [];
    for (const [number, one] of map.clusters.slice(0, MAX_NAMES).entries()) {
      const ys = one.outline.map((corner) => corner[1]);
      const xs = one.outline.map((corner) => corner[0]);
      const [middle, top] = this.toScreen([(Math.min(...xs) + Math.max(...xs)) / 2, Math.max(...ys)]);
      const text = `${number + 1} ${ownFeature(one) ?? one.title}`;
      const half = pen.measureText(text).width / 2 + 3;
      const y = top - 9;
      if (middle + half < 0 || middle - half > this.width || y < 8 || y > this.height) continue;
      const x = Math.min(Math.max(middle, half), Math.max(half, this.width - half)); // whole, also at the edge
      if (taken.some(([l, r, t, b]) => x + half > l && x - half < r && y + 8 > t && y - 8 < b)) continue;
      taken.push([x - half, x + half, y - 8, y + 8]);
      pen.globalAlpha = 0.8;
      pen.fillStyle = theme.surface;
      pen.fillRect(x - half, y - 8, 2 * half, 16);
      pen.globalAlpha = 1;
      pen.fillStyle = theme.text;
      pen.fillText(text, x, y);
    }
  }

  private trace(corners: readonly Point[]): void {
    this.pen.beginPath();
    for (const [x, y] of corners) this.pen.lineTo(x, y);
    this.pen.closePath();
  }
}
