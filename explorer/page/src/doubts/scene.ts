// Points of a file as a scene: upright, around the origin, and of the size of a body, whatever the unit of the file.

import type { Frames, Place } from "./types";

/** Metres that the largest extent of a scene becomes. */
const SIZE_M = 1.7;

/** Return a place with its vertical axis, such as "z" or "-y", turned to Y; the axes stay right-handed. */
export function upright([x, y, z]: Place, up: string): Place {
  const place = [x, y, z] as const;
  const index = "xyz".indexOf(up.at(-1) ?? "y");
  const sign = up.startsWith("-") ? -1 : 1;
  return [place[(index + 2) % 3] as number, sign * (place[index] as number), sign * (place[(index + 1) % 3] as number)];
}

/** Return frames of points as a scene: each around its own middle, all in the same scale. */
export function sceneOf(frames: Frames, up = "y"): Frames {
  const turned = frames.map((frame) => frame.map((place) => place && upright(place, up)));
  const boxes = turned.map(boxOf);
  const sizes = boxes.flatMap((box) => (box === null ? [] : [box.size])).sort((a, b) => a - b);
  const scale = SIZE_M / (sizes[Math.floor(sizes.length / 2)] || 1);
  return turned.map((frame, index) => {
    const middle = boxes[index]?.middle ?? [0, 0, 0];
    return frame.map((place) => place && [scale * (place[0] - middle[0]), scale * (place[1] - middle[1]), scale * (place[2] - middle[2])] as const);
  });
}

/** Return the middle of the points of a frame, and their largest extent; null without any. */
function boxOf(frame: readonly (Place | null)[]): { middle: Place; size: number } | null {
  const seen = frame.filter((place) => place !== null);
  if (seen.length === 0) return null;
  const ends = ([0, 1, 2] as const).map((axis) => {
    const along = seen.map((place) => place[axis]);
    return [Math.min(...along), Math.max(...along)] as const;
  });
  const middle = ends.map(([low, high]) => (low + high) / 2) as unknown as Place;
  return { middle, size: Math.max(...ends.map(([low, high]) => high - low)) };
}

/** Return the index of the point that is nearest to a place of the picture, −1 if none is within a distance. */
export function nearest(points: readonly (readonly [number, number] | null)[], x: number, y: number, within: number): number {
  let [best, least] = [-1, within];
  points.forEach((point, index) => {
    const far = point === null ? Infinity : Math.hypot(point[0] - x, point[1] - y);
    if (far < least) [best, least] = [index, far];
  });
  return best;
}

/** Return names by their side: those that begin with l or r and have a counterpart, and the others. */
export function bySide(names: readonly string[]): { left: string[]; middle: string[]; right: string[] } {
  const known = new Set(names);
  const side = (name: string) => {
    const other = name.startsWith("l") ? "r" : name.startsWith("r") ? "l" : "";
    return other !== "" && known.has(other + name.slice(1)) ? name.charAt(0) : "";
  };
  return {
    left: names.filter((name) => side(name) === "l"),
    middle: names.filter((name) => side(name) === ""),
    right: names.filter((name) => side(name) === "r"),
  };
}
