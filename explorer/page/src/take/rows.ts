// The rows of the lanes: their order, heights and places, and what lies at a point of one.

import type { Feature } from "../api/types";
import { sideOf, type Side } from "../motion/body";
import type { Lane, LaneGroup, Segment } from "./types";

export interface FeatureRow {
  kind: "feature";
  id: string;
  name: string;
  title: string;
  bit: number;
  side: Side;
  unknown: boolean;
}

export interface SegmentRow {
  kind: "segments";
  id: string;
  name: string;
  title: string;
  lane: Lane;
  /** The line of each segment: those that overlap lie below each other. */
  lines: readonly number[];
  count: number;
}

export interface CurveRow {
  kind: "curve";
  id: string;
  name: string;
  title: string;
  values: Float32Array;
  threshold: number;
  /** The value at the upper edge. */
  top: number;
  unit: string;
  /** What lies above the threshold counts, not what lies below. */
  above: boolean;
}

export interface GroupRow {
  kind: "group";
  id: string;
  name: string;
  title: string;
  open: boolean;
}

export type Row = (FeatureRow | SegmentRow | CurveRow | GroupRow) & { y: number; height: number };
type Bare = FeatureRow | SegmentRow | CurveRow | GroupRow;

export const LINE = 18;
export const FEATURE = 13;
const HEIGHTS = { feature: FEATURE, curve: 62, group: 22 } as const;

export const GROUP_NAMES: Record<LaneGroup, string> = {
  labels: "Labels",
  ground_truth: "Ground truth",
  annotations: "Annotations",
  compared: "Compared methods",
  hits: "Hits",
  limbs: "Limbs",
  duplicates: "Duplicates",
  quality: "Quality",
};

const FEATURE_GROUPS: Record<string, string> = { upper: "Upper body", lower: "Lower body", mix: "Whole body" };
const GROUPS = Object.keys(GROUP_NAMES) as LaneGroup[];

/** Groups that are closed until somebody opens them. */
export const CLOSED: readonly string[] = ["compared"];

/** Return the line of each segment, and the number of lines. */
export function stacked(segments: readonly Segment[]): { lines: number[]; count: number } {
  const order = segments.map((_, i) => i).sort((a, b) => at(segments, a).start - at(segments, b).start || a - b);
  const ends: number[] = [];
  const lines = new Array<number>(segments.length).fill(0);
  for (const i of order) {
    const { start, stop } = at(segments, i);
    let line = ends.findIndex((end) => end <= start);
    if (line < 0) line = ends.length;
    ends[line] = stop;
    lines[i] = line;
  }
  return { lines, count: Math.max(1, ends.length) };
}

const at = (segments: readonly Segment[], i: number): Segment => segments[i] as Segment;

/** Return all rows from the top to the bottom; those of closed groups are left out. */
export function makeRows(
  lanes: readonly Lane[],
  curves: readonly CurveRow[],
  features: readonly Feature[],
  unknown: ReadonlySet<number>,
  closed: ReadonlySet<string>,
): Row[] {
  const rows: Bare[] = [];
  const group = (id: string, name: string, title: string, inside: readonly Bare[]) => {
    if (inside.length === 0) return;
    const open = !closed.has(id);
    rows.push({ kind: "group", id, name, title, open });
    if (open) rows.push(...inside);
  };
  for (const id of GROUPS) {
    const own = lanes.filter((lane) => lane.group === id);
    group(id, GROUP_NAMES[id], counted(own.length, "lane"), own.map(segmentRow));
    if (id === "annotations") group("curves", "Distance curves", counted(curves.length, "curve"), curves);
  }
  for (const id of new Set(features.map((one) => one.group))) {
    const own = features.filter((one) => one.group === id);
    const name = FEATURE_GROUPS[id] ?? (id === "" ? "Features" : id);
    group(`features/${id}`, name, counted(own.length, "feature"), own.map((one) => featureRow(one, unknown.has(one.bit))));
  }
  let y = 0;
  return rows.map((row) => {
    const height = row.kind === "segments" ? row.count * LINE + 4 : HEIGHTS[row.kind];
    const placed = { ...row, y, height };
    y += height;
    return placed;
  });
}

const counted = (count: number, name: string) => `${count} ${name}${count === 1 ? "" : "s"}`;

function segmentRow(lane: Lane): SegmentRow {
  const title = lane.detail === "" ? lane.name : `${lane.name}: ${lane.detail}`;
  return { kind: "segments", id: lane.id, name: lane.name, title, lane, ...stacked(lane.segments) };
}

function featureRow(feature: Feature, unknown: boolean): FeatureRow {
  const { bit, name, description } = feature;
  const title = `F${bit + 1} ${name}: ${description}${unknown ? " (unknown: the body lacks joints)" : ""}`;
  return { kind: "feature", id: `feature/${bit}`, name, title, bit, side: sideOf(name), unknown };
}

export function rowAt(rows: readonly Row[], y: number): Row | null {
  return rows.find((row) => y >= row.y && y < row.y + row.height) ?? null;
}

/** Return the segment of a row at a frame and a height within the row; the shortest of several. */
export function segmentAt(row: SegmentRow, frame: number, y: number): Segment | null {
  const line = Math.floor((y - 2) / LINE);
  let found: Segment | null = null;
  row.lane.segments.forEach((one, i) => {
    if (row.lines[i] !== line || frame < one.start || frame >= one.stop) return;
    if (found === null || one.stop - one.start < found.stop - found.start) found = one;
  });
  return found;
}
