// What the server answers to questions (explorer/{hits,examples,keyframes,sql}.py).

import type { Filter, Same, Value } from "../api/types";

export interface Interval {
  take: string;
  start: number;
  stop: number;
  mirrored: boolean;
}

export interface Hit extends Interval {
  take_id: number;
  cost: number | null;
  /** The similarity to the examples, and whether the hit probably shows the same motion; null where unknown. */
  similarity?: number | null;
  probable?: boolean | null;
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
  filters?: Filter[];
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

/** Two intervals are of the same place if they share so much of the shorter one (as explorer/hits.py has it). */
const SHARED = 0.5;

/** Return which share of the shorter of two intervals lies in the other one. */
export function shareOf(one: Interval, other: Interval): number {
  if (one.take !== other.take) return 0;
  const common = Math.min(one.stop, other.stop) - Math.max(one.start, other.start);
  return Math.max(0, common) / Math.min(one.stop - one.start, other.stop - other.start);
}

export function samePlace(one: Interval, other: Interval): boolean {
  return shareOf(one, other) >= SHARED;
}

/** A statement of a person about the place of a hit, as the store has it. */
export interface Known {
  class: string;
  verdict: string;
  share: number;
}

/** Return an interval as the server takes it. */
export function asked({ take, start, stop, mirrored }: Interval): Interval {
  return { take, start, stop, mirrored };
}

/** An interval as addresses have it. */
export type Packed = [take: string, start: number, stop: number, mirrored: 0 | 1];

export function packed({ take, start, stop, mirrored }: Interval): Packed {
  return [take, start, stop, mirrored ? 1 : 0];
}

export function unpacked(list: unknown): Interval[] {
  if (!Array.isArray(list)) return [];
  return (list as unknown[])
    .filter((one): one is Packed => Array.isArray(one) && typeof one[0] === "string" && one.length === 4)
    .map(([take, start, stop, mirrored]) => ({ take, start, stop, mirrored: mirrored === 1 }));
}
