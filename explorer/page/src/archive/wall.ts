// The lines of the wall: headings of groups, and rows of takes between them.

import type { Value } from "../api/types";

/** Takes that follow each other in the order of the wall and have the same value of a column. */
export interface WallGroup {
  /** The value; undefined for the takes of all groups that are not listed. */
  value: Value | undefined;
  takes: number;
  hours: number;
}

export type WallLine =
  | { kind: "heading"; group: number }
  | { kind: "row"; group: number; first: number; stop: number };

/** Return the lines of the wall, the takes numbered in their order.
 *
 * A line of takes holds takes of one group. Without headings all groups but the first are ignored. */
export function wallLines(groups: readonly WallGroup[], across: number, headings: boolean): WallLine[] {
  const lines: WallLine[] = [];
  let first = 0;
  groups.forEach((one, group) => {
    if (headings) lines.push({ kind: "heading", group });
    const stop = first + one.takes;
    for (; first < stop; first += across) lines.push({ kind: "row", group, first, stop: Math.min(stop, first + across) });
    first = stop;
  });
  return lines;
}

/** Return the place of the line that holds a take, -1 where none does. */
export function lineOf(lines: readonly WallLine[], take: number): number {
  let [low, high] = [0, lines.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (firstOf(lines, middle) <= take) low = middle + 1;
    else high = middle;
  }
  for (let place = low - 1; place >= 0; place--) {
    const line = lines[place] as WallLine;
    if (line.kind === "row") return take < line.stop ? place : -1;
  }
  return -1;
}

/** Return the first take at or below a line; headings stand before their takes. */
function firstOf(lines: readonly WallLine[], place: number): number {
  for (let at = place; at < lines.length; at++) {
    const line = lines[at] as WallLine;
    if (line.kind === "row") return line.first;
  }
  return Infinity;
}

/** Return the take that lies `by` rows of takes below a take (above, where negative), as near to its column as can be. */
export function takeBelow(lines: readonly WallLine[], take: number, by: number): number {
  const step = Math.sign(by);
  let place = lineOf(lines, take);
  const start = lines[place];
  if (start?.kind !== "row") return 0;
  let found = start;
  for (let rest = Math.abs(by); rest > 0; ) {
    const line = lines[(place += step)];
    if (line === undefined) break;
    if (line.kind === "heading") continue;
    found = line;
    rest--;
  }
  return Math.min(found.stop - 1, found.first + (take - start.first));
}

/** Return the first take of the next group, or of this group and then the one before. */
export function takeOfGroup(groups: readonly WallGroup[], take: number, step: 1 | -1): number {
  const firsts: number[] = [];
  let total = 0;
  for (const group of groups) {
    firsts.push(total);
    total += group.takes;
  }
  if (step > 0) return firsts.find((first) => first > take) ?? take;
  return firsts.filter((first) => first < take).pop() ?? 0;
}

const LONGEST_S = 8;

/** Return the frames of a take that its figure shows: all, or the middle eight seconds of a longer take. */
export function shownFrames(frames: number, rateHz: number): [number, number] {
  const longest = Math.max(1, Math.round(LONGEST_S * rateHz));
  if (frames <= longest) return [0, frames];
  const start = Math.floor((frames - longest) / 2);
  return [start, start + longest];
}
