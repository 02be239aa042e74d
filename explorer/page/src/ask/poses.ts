// Changes of keyframe queries while somebody edits them; nothing here draws or asks.

import type { Feature } from "../api/types";
import type { Gap, Pose, Query } from "./types";

export type State = "on" | "off" | "any";

export const NEW_GAP: Gap = { low: 0.1, high: 1 };
export const MAX_POSES = 20;

export function stateOf(pose: Pose, name: string): State {
  return pose.on.includes(name) ? "on" : pose.off.includes(name) ? "off" : "any";
}

/** Return a pose with a feature in another state. */
export function withState(pose: Pose, name: string, state: State): Pose {
  const without = (names: string[]) => names.filter((one) => one !== name);
  return {
    on: state === "on" ? [...without(pose.on), name] : without(pose.on),
    off: state === "off" ? [...without(pose.off), name] : without(pose.off),
  };
}

/** Return the state after a click: on, off, any, and on again. */
export function nextState(state: State): State {
  return state === "any" ? "on" : state === "on" ? "off" : "any";
}

export function withPose(query: Query, place: number, pose: Pose): Query {
  return { ...query, poses: query.poses.map((one, i) => (i === place ? pose : one)) };
}

export function withGap(query: Query, place: number, gap: Gap): Query {
  return { ...query, gaps: query.gaps.map((one, i) => (i === place ? gap : one)) };
}

export function addPose(query: Query, pose: Pose): Query {
  return {
    ...query,
    poses: [...query.poses, pose],
    gaps: query.poses.length > 0 ? [...query.gaps, NEW_GAP] : [],
  };
}

/** Return a query without one of its poses; the gaps on both sides of it become one. */
export function withoutPose(query: Query, place: number): Query {
  const poses = query.poses.filter((_, i) => i !== place);
  const gaps = [...query.gaps];
  const before = gaps[place - 1];
  const after = gaps[place];
  if (place === 0) gaps.shift();
  else if (after === undefined) gaps.pop();
  else if (before !== undefined) {
    const high = before.high === null || after.high === null ? null : before.high + after.high;
    gaps.splice(place - 1, 2, { low: before.low + after.low, high });
  }
  return { ...query, poses, gaps };
}

/** Return the features by their groups, in the order of their bits. */
export function grouped(features: readonly Feature[]): [string, Feature[]][] {
  const groups = new Map<string, Feature[]>();
  for (const feature of features) groups.set(feature.group, [...(groups.get(feature.group) ?? []), feature]);
  return [...groups];
}
