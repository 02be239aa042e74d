// Edits of a template: weights of features, columns that are kept, and τ. They are part of the address.

import { useCallback, useMemo } from "react";

import { useJsonParameter, useParameter, useParameters } from "../app/address";
import type { Clip } from "./types";

export type Weights = Record<string, number>;

export interface Edits {
  /** Features that do not count as before: their factor, 0 for off. */
  weights: Weights;
  /** The columns [first, stop) that are kept. */
  first: number;
  stop: number;
  tau: number | null;
}

const NO_WEIGHTS: Weights = {};
export const MAX_WEIGHT = 1000;

/** Return weights as an address may hold them: numbers from 0 to 1000 that are not 1. */
export function soundWeights(given: unknown): Weights {
  if (typeof given !== "object" || given === null || Array.isArray(given)) return NO_WEIGHTS;
  const sound = Object.entries(given).filter(
    (entry): entry is [string, number] =>
      typeof entry[1] === "number" && entry[1] >= 0 && entry[1] <= MAX_WEIGHT && entry[1] !== 1,
  );
  return sound.length === 0 ? NO_WEIGHTS : Object.fromEntries(sound);
}

/** Return the weight of a feature after a key in the matrix, null for a key that changes none. */
export function weightAfter(key: string, weight: number): number | null {
  if (key === "x") return weight === 0 ? 1 : 0;
  if (key === "+") return Math.min(MAX_WEIGHT, weight + 0.5);
  return key === "-" ? Math.max(0, weight - 0.5) : null;
}

/** Return the columns that are kept, at least one. */
export function soundColumns(from: string | null, to: string | null, columns: number): [number, number] {
  const number = (text: string | null, absent: number) =>
    text !== null && /^\d+$/.test(text) ? Math.min(columns, Number(text)) : absent;
  const first = number(from, 0);
  const stop = number(to, columns);
  return first < stop ? [first, stop] : [0, columns];
}

export function isEdited(edits: Edits, columns: number): boolean {
  return edits.first > 0 || edits.stop < columns || Object.keys(edits.weights).length > 0 || edits.tau !== null;
}

/** Return the edits that the address holds, and functions that change them. */
export function useEdits(columns: number) {
  const [given, setGiven] = useJsonParameter<unknown>("weights", NO_WEIGHTS);
  const [from] = useParameter("from");
  const [to] = useParameter("to");
  const [text, setText] = useParameter("tau");
  const set = useParameters();
  const edits = useMemo<Edits>(() => {
    const [first, stop] = soundColumns(from, to, columns);
    const tau = text === null ? Number.NaN : Number(text);
    return { weights: soundWeights(given), first, stop, tau: tau > 0 && tau <= 1 ? tau : null };
  }, [given, from, to, text, columns]);
  const setWeight = useCallback(
    (feature: string, weight: number) => {
      const next = soundWeights({ ...edits.weights, [feature]: weight });
      setGiven(next === NO_WEIGHTS ? null : next);
    },
    [edits.weights, setGiven],
  );
  const setColumns = useCallback(
    (first: number, stop: number) => set({ from: first > 0 ? String(first) : null, to: stop < columns ? String(stop) : null }),
    [set, columns],
  );
  const setTau = useCallback((tau: number | null) => setText(tau === null ? null : String(tau)), [setText]);
  const reset = useCallback(() => set({ weights: null, from: null, to: null, tau: null }, true), [set]);
  return { edits, setWeight, setColumns, setTau, reset };
}

/** Return the address of a search by some clips, as the page Ask reads it. */
export function askAddress(clips: readonly Clip[]): string {
  const more = clips.map((one) => [one.take, one.start, one.stop, one.mirrored ? 1 : 0]);
  return `/ask?${new URLSearchParams({ way: "example", more: JSON.stringify(more) }).toString()}`;
}

/** Most clips that an address holds; servers refuse longer addresses. */
export const MAX_CLIPS = 100;

/** Return how many spreads (median absolute deviations) a cost is above the median, null where there is no spread. */
export function spreadsAbove(cost: number, far: { median: number; spread: number }): number | null {
  return far.spread > 0 ? (cost - far.median) / far.spread : null;
}
