// What the server answers to questions (pipelines/explorer/{hits,examples,keyframes,sql}.py).

import type { Same, Value } from "../api/types";

export interface Interval {
  take: string;
  start: number;
  stop: number;
  mirrored: boolean;
}

export interface Hit extends Interval {
  take_id: number;
  cost: number | null;
  name: string;
}

export interface ExamplesAnswer extends Same {
  hits: Hit[];
  total: number;
  more: boolean;
  hours: number;
  seconds: number;
  tau: number;
  template: { columns: number; clips: string[]; weights: Record<string, number> };
  remarks: string[];
  version: number;
}

export interface ExamplesQuestion {
  positives: Interval[];
  negatives: Interval[];
  mirror: boolean;
  tau: number;
  top: number;
  where?: string;
  name?: string;
}

export interface HitAnswer {
  first: number;
  curve: (number | null)[];
  tau: number;
  cost: number | null;
  start: number;
  columns: number[];
  template_columns: number;
  contradicted: { feature: string; share: number }[];
}

export interface Pose {
  on: string[];
  off: string[];
}

export interface Gap {
  low: number;
  high: number | null;
}

export interface Query {
  name: string;
  poses: Pose[];
  gaps: Gap[];
}

export interface KeyframesAnswer extends Same {
  text: string;
  query: Query | null;
  fault: { message: string; line: number | null } | null;
  hits: Hit[];
  total: number;
  takes: number;
  share: number;
  seconds: number;
  remarks: string[];
}

export interface SqlAnswer extends Same {
  columns: { name: string; type: string }[];
  rows: Value[][];
  offset: number;
  total: number;
  counted: boolean;
  kept: number;
  seconds: number;
  hits: Hit[] | null;
}

export interface ViewFacts {
  name: string;
  about: string;
  columns: { name: string; type: string; about: string }[];
  example: string;
}

export function keyOf({ take, start, stop, mirrored }: Interval): string {
  return JSON.stringify([take, start, stop, mirrored]);
}

export function intervalOf(key: string): Interval {
  const [take, start, stop, mirrored] = JSON.parse(key) as [string, number, number, boolean];
  return { take, start, stop, mirrored };
}

/** Return an interval as the server takes it. */
export function asked({ take, start, stop, mirrored }: Interval): Interval {
  return { take, start, stop, mirrored };
}
