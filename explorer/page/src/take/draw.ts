// Drawing of the lanes on canvases. The picture of the lanes changes with the view alone; playhead, selection and pointer
// lie on a canvas above it, so that scrubbing draws two lines.

import type { Colours } from "../motion/colours";
import { clock, ticks, type View, xOf } from "./axis";
import { type CurveRow, FEATURE, type FeatureRow, LINE, type Row, type SegmentRow } from "./rows";
import type { Segment } from "./types";
import type { Words } from "./words";

/** Levels of a colour, by the share of a pixel's frames in which a feature is on. */
const LEVELS = 16;

/** The picture of features: a pixel of the image for each column of the screen and each feature. */
export class FeatureImage {
  private image: ImageData | null = null;
  private readonly canvas = document.createElement("canvas");
  private readonly pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private tones: Record<string, Uint32Array> = {};
  private theme: Colours | null = null;

  draw(pen: CanvasRenderingContext2D, rows: readonly Row[], words: Words, view: View, width: number, theme: Colours) {
    const shown = rows.filter((row): row is FeatureRow & Row => row.kind === "feature");
    if (shown.length === 0 || width < 1) return;
    if (this.theme !== theme) this.mix(theme);
    if (this.image === null || this.image.width !== width || this.image.height !== shown.length) {
      this.canvas.width = width;
      this.canvas.height = shown.length;
      this.image = this.pen.createImageData(width, shown.length);
    }
    const pixels = new Uint32Array(this.image.data.buffer);
    const edges = frameEdges(view, width, words.frames);
    shown.forEach((row, i) => this.fill(pixels.subarray(i * width, (i + 1) * width), row, words, edges));
    this.pen.putImageData(this.image, 0, 0);
    pen.imageSmoothingEnabled = false;
    shown.forEach((row, i) => pen.drawImage(this.canvas, 0, i, width, 1, 0, row.y + 1, width, FEATURE - 2));
  }

  private fill(pixels: Uint32Array, row: FeatureRow, words: Words, edges: Int32Array): void {
    const tones = this.tones[row.unknown ? "unknown" : row.side] as Uint32Array;
    const lost = (this.tones.lost as Uint32Array)[0] as number;
    for (let x = 0; x < pixels.length; x++) {
      const start = edges[2 * x] as number;
      const stop = edges[2 * x + 1] as number;
      if (stop > words.ready || stop <= start) pixels[x] = tones[0] as number;
      else if (words.lostWithin(start, stop) > 0) pixels[x] = lost;
      else {
        const share = words.onWithin(row.bit, start, stop) / (stop - start);
        pixels[x] = tones[share === 0 ? 0 : Math.max(4, Math.round(share * (LEVELS - 1)))] as number;
      }
    }
  }

  private mix(theme: Colours): void {
    this.theme = theme;
    const off = rgb(theme.raised);
    const scale = (colour: string) => Uint32Array.from({ length: LEVELS }, (_, k) => mixed(off, rgb(colour), k / (LEVELS - 1)));
    this.tones = {
      left: scale(theme.left),
      right: scale(theme.right),
      middle: scale(theme.middle),
      unknown: new Uint32Array(LEVELS).fill(mixed(rgb(theme.surface), rgb(theme.surface), 0)),
      lost: new Uint32Array(1).fill(mixed(off, rgb(theme.muted), 0.45)),
    };
  }
}

/** Return the frames [start, stop) that each pixel stands for, at least one. */
function frameEdges(view: View, width: number, frames: number): Int32Array {
  const edges = new Int32Array(2 * width);
  const step = (view.to - view.from) / width;
  for (let x = 0; x < width; x++) {
    const start = Math.min(frames, Math.max(0, Math.floor(view.from + x * step)));
    edges[2 * x] = start;
    edges[2 * x + 1] = Math.min(frames, Math.max(start + 1, Math.floor(view.from + (x + 1) * step)));
  }
  return edges;
}

const parsed = new Map<string, readonly [number, number, number]>();

function rgb(colour: string): readonly [number, number, number] {
  let found = parsed.get(colour);
  if (found === undefined) {
    const digits = colour.replace("#", "");
    const part = (i: number) => parseInt(digits.slice(2 * i, 2 * i + 2), 16);
    found = [part(0), part(1), part(2)];
    parsed.set(colour, found);
  }
  return found;
}

function mixed(one: readonly [number, number, number], other: readonly [number, number, number], share: number): number {
  const part = (i: 0 | 1 | 2) => Math.round(one[i] + (other[i] - one[i]) * share);
  return (0xff000000 | (part(2) << 16) | (part(1) << 8) | part(0)) >>> 0;
}

/** Return whether black text reads better than white text on a colour. */
function isLight(colour: string): boolean {
  const [r, g, b] = rgb(colour);
  return 0.299 * r + 0.587 * g + 0.114 * b > 150;
}

/** Draw the segments of a lane; one that is narrower than a pixel gets one. */
export function drawSegments(
  pen: CanvasRenderingContext2D,
  row: SegmentRow & Row,
  view: View,
  width: number,
  theme: Colours,
  colourOf: (segment: Segment) => string,
): void {
  const reached = new Array<number>(row.count).fill(-1);
  row.lane.segments.forEach((one, i) => {
    if (one.stop <= view.from || one.start >= view.to) return;
    const line = row.lines[i] as number;
    const x = Math.max(0, xOf(view, one.start, width));
    const end = Math.min(width, Math.max(x + 1, xOf(view, one.stop, width)));
    if (end - x < 2 && x < (reached[line] as number)) return; // drawn already
    reached[line] = x + 1;
    const y = row.y + 2 + line * LINE;
    const colour = colourOf(one);
    const sure = one.confidence === undefined ? 1 : 0.35 + 0.65 * one.confidence;
    pen.globalAlpha = row.lane.group === "quality" || one.verdict === "negative" ? 0.55 : sure;
    pen.fillStyle = colour;
    pen.fillRect(x, y, Math.max(1, end - x - 0.5), LINE - 2);
    pen.globalAlpha = 1;
    if (one.verdict === "negative") strike(pen, x, y, end - x, theme);
    if (end - x > 26 && one.class !== undefined) write(pen, one, x, y, end - x, sure, colour, theme);
  });
}

function strike(pen: CanvasRenderingContext2D, x: number, y: number, width: number, theme: Colours): void {
  pen.strokeStyle = theme.text;
  pen.lineWidth = 1;
  pen.beginPath();
  pen.moveTo(x, y + LINE / 2);
  pen.lineTo(x + width, y + LINE / 2);
  pen.stroke();
}

function write(
  pen: CanvasRenderingContext2D,
  one: Segment,
  x: number,
  y: number,
  width: number,
  sure: number,
  colour: string,
  theme: Colours,
): void {
  pen.save();
  pen.beginPath();
  pen.rect(x, y, width - 3, LINE);
  pen.clip();
  pen.fillStyle = sure > 0.7 ? (isLight(colour) ? "#15181c" : "#ffffff") : theme.text;
  pen.fillText(one.class ?? "", x + 4, y + LINE / 2);
  pen.restore();
}

/** Draw a curve: for each pixel its extreme value, the threshold, and what counts: costs below it, errors above it. */
export function drawCurve(
  pen: CanvasRenderingContext2D,
  row: CurveRow & Row,
  view: View,
  width: number,
  theme: Colours,
): void {
  const { values, top, threshold, y, height } = row;
  const bottom = y + height - 4;
  const scale = (height - 8) / top;
  const edges = frameEdges(view, width, values.length);
  const line = bottom - threshold * scale;
  pen.strokeStyle = theme.line;
  pen.lineWidth = 1;
  pen.strokeRect(0.5, y + 2.5, width - 1, height - 5);
  pen.beginPath();
  let drawn = false;
  const counting: number[] = [];
  for (let x = 0; x < width; x++) {
    let extreme = Infinity;
    for (let t = edges[2 * x] as number; t < (edges[2 * x + 1] as number); t++) {
      const value = values[t] as number;
      if (value === Infinity) continue;
      if (extreme === Infinity || (row.above ? value > extreme : value < extreme)) extreme = value;
    }
    if (extreme === Infinity) {
      drawn = false;
      continue;
    }
    const at = bottom - Math.min(extreme, top) * scale;
    if (row.above ? extreme > threshold : extreme < threshold) counting.push(x, at);
    if (drawn) pen.lineTo(x + 0.5, at);
    else pen.moveTo(x + 0.5, at);
    drawn = true;
  }
  pen.strokeStyle = theme.text;
  pen.lineWidth = 1.2;
  pen.stroke();
  pen.fillStyle = theme.left;
  pen.globalAlpha = 0.45;
  for (let i = 0; i < counting.length; i += 2) {
    const at = counting[i + 1] as number;
    pen.fillRect(counting[i] as number, at, 1, bottom - at);
  }
  pen.globalAlpha = 1;
  pen.strokeStyle = theme.right;
  pen.setLineDash([5, 4]);
  pen.beginPath();
  pen.moveTo(0, line);
  pen.lineTo(width, line);
  pen.stroke();
  pen.setLineDash([]);
}

/** Draw the axis of time. */
export function drawAxis(pen: CanvasRenderingContext2D, view: View, rateHz: number, width: number, height: number, theme: Colours): void {
  pen.clearRect(0, 0, width, height);
  pen.strokeStyle = theme.muted;
  pen.fillStyle = theme.muted;
  pen.lineWidth = 1;
  pen.beginPath();
  const every = ticks(view, rateHz, width);
  const digits = every.length > 1 && (every[1] as number) - (every[0] as number) < 1 ? 1 : 0;
  for (const second of every) {
    const x = Math.round(xOf(view, second * rateHz, width)) + 0.5;
    pen.moveTo(x, height - 5);
    pen.lineTo(x, height);
    if (x < width - 30) pen.fillText(clock(second, digits), x + 3, height / 2);
  }
  pen.stroke();
}
