// The map of the archive without its picture: what the server answers, which points are where, and how ids are packed.

import type { Same } from "../api/types";

export interface MapCluster {
  points: number;
  takes: number;
  hours: number;
  title: string;
  words: string;
  traits: { feature: string; share: number; rest: number }[];
  classes: { value: string | null; takes: number }[];
  typical: number[];
  outline: [number, number][];
}

export type Unit = "takes" | "windows";

export interface ArchiveMap extends Same {
  unit: Unit;
  version: number;
  takes: number[];
  names: string[];
  /** Index of the take of each point. */
  owner: number[];
  starts: number[];
  stops: number[];
  x: number[];
  y: number[];
  cluster: number[];
  clusters: MapCluster[];
  window_seconds: number | null;
  remarks: string[];
}

/** Values of a column for the takes of a map, in their order. */
export interface MapTakes extends Same {
  column: string;
  takes: number;
  values?: string[];
  codes?: number[];
  numbers?: (number | null)[];
  fits?: number[];
}

export type Point = readonly [number, number];

/** Codes of points without a value, and of those that do not fit the filters. */
export const NO_VALUE = -1;
export const NO_FIT = -2;

export interface Legend {
  labels: string[];
  /** How many points have each label. */
  counts: number[];
  /** For each point the index of its label, NO_VALUE or NO_FIT. */
  codes: Int16Array;
}

/** Most values that have a sign of their own; the others share the one of "other values". */
export const SIGNS = 18;
const RANGES = 6;

/** Return which points fit, in which colour: by cluster, by the values of a column, or by ranges of its numbers. */
export function legendOf(map: ArchiveMap, takes: MapTakes, by: "cluster" | "column"): Legend {
  const [labels, ofTake] = takes.numbers === undefined ? valueCodes(takes) : rangeCodes(takes.numbers, takes.fits ?? []);
  const codes = new Int16Array(map.owner.length);
  for (let i = 0; i < codes.length; i++) codes[i] = ofTake[map.owner[i] as number] ?? NO_FIT;
  if (by === "column") return counted(labels, codes);
  const many = map.clusters.length > SIGNS;
  const names = map.clusters.slice(0, SIGNS).map((one, number) => clusterName(one, number));
  for (let i = 0; i < codes.length; i++)
    if (codes[i] !== NO_FIT) codes[i] = Math.min(map.cluster[i] as number, many ? SIGNS : map.clusters.length);
  return counted(many ? [...names, "smaller clusters"] : names, codes);
}

function counted(labels: string[], codes: Int16Array): Legend {
  const counts = labels.map(() => 0);
  for (const code of codes) if (code >= 0) counts[code] = (counts[code] ?? 0) + 1;
  return { labels, counts, codes };
}

/** The name of a cluster: its class, and where it has none the feature that sets it apart most. */
export function clusterName(one: MapCluster, number: number): string {
  const feature = ownFeature(one);
  return `${number + 1}: ${one.title}${feature === null ? "" : `, ${feature}`}`;
}

/** Return the feature that sets a cluster without a class apart most, in words; null for one with a class. */
export function ownFeature({ title, traits: [first] }: MapCluster): string | null {
  return title !== "no class" || first === undefined ? null : `${first.share > first.rest ? "" : "not "}${first.feature}`;
}

function valueCodes({ values = [], codes = [] }: MapTakes): [string[], number[]] {
  if (values.length <= SIGNS) return [values, codes];
  return [
    [...values.slice(0, SIGNS), `${values.length - SIGNS} other values`],
    codes.map((code) => Math.min(code, SIGNS)),
  ];
}

/** Return ranges of numbers with about as many takes each. */
function rangeCodes(numbers: readonly (number | null)[], fits: readonly number[]): [string[], number[]] {
  const sorted = numbers.filter((one): one is number => one !== null).sort((a, b) => a - b);
  const cuts = Array.from({ length: RANGES - 1 }, (_, i) => sorted[Math.floor(((i + 1) * sorted.length) / RANGES)]);
  const inner = [...new Set(cuts)].filter((one): one is number => one !== undefined && one > (sorted[0] ?? 0));
  const ends = [sorted[0], ...inner, sorted[sorted.length - 1]];
  const short = (value: number | undefined) => String(Number((value ?? 0).toPrecision(4)));
  const labels =
    sorted.length === 0
      ? []
      : Array.from({ length: inner.length + 1 }, (_, i) =>
          i === inner.length ? `${short(ends[i])} to ${short(ends[i + 1])}` : `${short(ends[i])} to below ${short(ends[i + 1])}`,
        );
  const code = (value: number | null, place: number) => {
    if (fits[place] === 0) return NO_FIT;
    return value === null ? NO_VALUE : inner.filter((cut) => value >= cut).length;
  };
  return [labels, numbers.map(code)];
}

/** Return the point nearest to a place, -1 if none that counts lies within a distance. */
export function nearest(map: ArchiveMap, [x, y]: Point, within: number, counts: (point: number) => boolean): number {
  let [found, least] = [-1, within * within];
  for (let i = 0; i < map.x.length; i++) {
    const [u, v] = [(map.x[i] as number) - x, (map.y[i] as number) - y];
    const distance = u * u + v * v;
    if (distance <= least && counts(i)) [found, least] = [i, distance];
  }
  return found;
}

export type Direction = "ArrowLeft" | "ArrowRight" | "ArrowUp" | "ArrowDown";

const AHEAD: Record<Direction, Point> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};

/** Return the nearest point in a direction, within 45° of it; what lies to the side counts as twice as far. */
export function neighbour(map: ArchiveMap, from: number, key: Direction, counts: (point: number) => boolean): number {
  const [ahead, up] = AHEAD[key];
  const [x, y] = [map.x[from] as number, map.y[from] as number];
  let [found, least] = [from, Infinity];
  for (let i = 0; i < map.x.length; i++) {
    const [u, v] = [(map.x[i] as number) - x, (map.y[i] as number) - y];
    const along = u * ahead + v * up;
    const aside = Math.abs(u * up) + Math.abs(v * ahead);
    if (along <= 0 || aside > along) continue;
    const distance = along + 2 * aside;
    if (distance < least && counts(i)) [found, least] = [i, distance];
  }
  return found;
}

/** Return the points inside a polygon (even-odd rule). */
export function inside(map: ArchiveMap, polygon: readonly Point[], counts: (point: number) => boolean): number[] {
  const xs = polygon.map((corner) => corner[0]);
  const ys = polygon.map((corner) => corner[1]);
  const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const found: number[] = [];
  for (let i = 0; i < map.x.length; i++) {
    const [x, y] = [map.x[i] as number, map.y[i] as number];
    if (x < left || x > right || y < low || y > high || !counts(i)) continue;
    let odd = false;
    for (let a = 0, b = polygon.length - 1; a < polygon.length; b = a++) {
      const [ya, yb] = [ys[a] as number, ys[b] as number];
      if (ya > y === yb > y) continue;
      const [xa, xb] = [xs[a] as number, xs[b] as number];
      if (x < ((xb - xa) * (y - ya)) / (yb - ya) + xa) odd = !odd;
    }
    if (odd) found.push(i);
  }
  return found;
}

/** Return ids as `chosen` of a filter: base64url of bits, of which the one with the number of each id is set. */
export function packedIds(ids: readonly number[]): string {
  const bytes = new Uint8Array(Math.floor(ids.reduce((most, id) => Math.max(most, id), -1) / 8) + 1);
  for (const id of ids) bytes[id >> 3] = (bytes[id >> 3] ?? 0) | (0x80 >> (id & 7));
  let text = "";
  for (const byte of bytes) text += String.fromCharCode(byte);
  return btoa(text).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

/** Return the ids of `chosen`; none where it is no base64url. */
export function unpackedIds(text: string): number[] {
  let bytes: string;
  try {
    bytes = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
  } catch {
    return [];
  }
  const found: number[] = [];
  for (let place = 0; place < bytes.length; place++)
    for (let bit = 0; bit < 8; bit++) if ((bytes.charCodeAt(place) & (0x80 >> bit)) !== 0) found.push(8 * place + bit);
  return found;
}

/** The longest address that the server reads: 64 KiB for its first line, of which other filters need some. */
export const LONGEST_CHOICE = 56_000;

/** Return the ids of the takes of some points, ascending. */
export function takesOf(map: ArchiveMap, points: Iterable<number>): number[] {
  const owners = new Set<number>();
  for (const point of points) owners.add(map.owner[point] as number);
  return [...owners].map((owner) => map.takes[owner] as number).sort((a, b) => a - b);
}
