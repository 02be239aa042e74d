// Hits that a person has accepted or rejected. They are kept in the session of the tab until they are saved, so that a
// reload, or a visit to another page, costs none. Those of another question (its scope) are not shown, nor saved with it.
// The next question finds the same places with slightly other ends: a verdict counts for every hit of its place.

import { createContext, useCallback, useContext, useMemo, useSyncExternalStore } from "react";

import { type Hit, type Interval, intervalOf, keyOf, samePlace, shareOf } from "./types";

export type Verdict = "yes" | "no";

/** What was said about a hit. */
export interface Mark {
  verdict: Verdict;
  /** True if it was said about an interval with other ends. */
  earlier: boolean;
}

const PLACE = "kinedex-ask-verdicts";
const listeners = new Set<() => void>();
type Side = Readonly<Record<string, Verdict>>;
type Held = Readonly<Record<string, Side>>;
const NONE: Side = {};
let held: Held = read();

function read(): Held {
  try {
    return JSON.parse(sessionStorage.getItem(PLACE) ?? "{}") as Held;
  } catch {
    return {};
  }
}

function write(next: Held): void {
  held = next;
  try {
    sessionStorage.setItem(PLACE, JSON.stringify(next));
  } catch {
    // without room in the session they last as long as the page
  }
  for (const listener of listeners) listener();
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export interface Verdicts {
  of: (hit: Interval) => Mark | undefined;
  /** Give a verdict; those of the same place go. */
  set: (hit: Hit, verdict: Verdict | null) => void;
  clear: () => void;
  accepted: Interval[];
  rejected: Interval[];
}

/** Return verdicts with that on a hit, which replaces those of its place; null takes them back. */
export function decided(verdicts: Side, hit: Interval, verdict: Verdict | null): Side {
  const others = Object.entries(verdicts).filter(([key]) => !samePlace(intervalOf(key), hit));
  const next = { ...Object.fromEntries(others) };
  return verdict === null ? next : { ...next, [keyOf(hit)]: verdict };
}

/** Return a function that answers with the verdict on a hit: its own, or that of the interval that shares most with it. */
export function marksOf(verdicts: Side): (hit: Interval) => Mark | undefined {
  const byTake = new Map<string, [Interval, Verdict][]>();
  for (const [key, verdict] of Object.entries(verdicts)) {
    const one = intervalOf(key);
    byTake.set(one.take, [...(byTake.get(one.take) ?? []), [one, verdict]]);
  }
  return (hit) => {
    const own = verdicts[keyOf(hit)];
    if (own !== undefined) return { verdict: own, earlier: false };
    let found: Mark | undefined;
    let most = 0;
    for (const [one, verdict] of byTake.get(hit.take) ?? []) {
      const share = shareOf(one, hit);
      if (!samePlace(one, hit) || share <= most) continue;
      most = share;
      found = { verdict, earlier: true };
    }
    return found;
  };
}

/** Return the scope of the verdicts on the hits of a way to ask that has no example. */
export function originOf(way: string): string {
  return `way:${way}`;
}

const Scope = createContext("");

/** The question that verdicts belong to. */
export const VerdictScope = Scope.Provider;

export function useVerdicts(): Verdicts {
  const scope = useContext(Scope);
  const every = useSyncExternalStore(subscribe, () => held[scope] ?? NONE);
  const set = useCallback(
    (hit: Hit, verdict: Verdict | null) => write({ ...held, [scope]: decided(held[scope] ?? NONE, hit, verdict) }),
    [scope],
  );
  const clear = useCallback(() => {
    const { [scope]: _, ...others } = held;
    write(others);
  }, [scope]);
  return useMemo(() => {
    const side = (wanted: Verdict) =>
      Object.entries(every)
        .filter(([, verdict]) => verdict === wanted)
        .map(([key]) => intervalOf(key));
    return { of: marksOf(every), set, clear, accepted: side("yes"), rejected: side("no") };
  }, [every, set, clear]);
}
