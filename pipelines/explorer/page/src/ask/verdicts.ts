// Hits that a person has accepted or rejected. They are kept in the session of the tab until they are saved, so that a
// reload, or a visit to another page, costs none.

import { useCallback, useMemo, useSyncExternalStore } from "react";

import { type Hit, type Interval, intervalOf, keyOf } from "./types";

export type Verdict = "yes" | "no";

const PLACE = "kinedex-ask-verdicts";
const listeners = new Set<() => void>();
let held: Readonly<Record<string, Verdict>> = read();

function read(): Record<string, Verdict> {
  try {
    return JSON.parse(sessionStorage.getItem(PLACE) ?? "{}") as Record<string, Verdict>;
  } catch {
    return {};
  }
}

function write(next: Record<string, Verdict>): void {
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
  of: (hit: Interval) => Verdict | undefined;
  set: (hit: Hit, verdict: Verdict | null) => void;
  clear: () => void;
  accepted: Interval[];
  rejected: Interval[];
}

export function useVerdicts(): Verdicts {
  const every = useSyncExternalStore(subscribe, () => held);
  const set = useCallback((hit: Hit, verdict: Verdict | null) => {
    const next = { ...held };
    const key = keyOf(hit);
    if (verdict === null) delete next[key];
    else next[key] = verdict;
    write(next);
  }, []);
  const clear = useCallback(() => write({}), []);
  return useMemo(() => {
    const side = (wanted: Verdict) =>
      Object.entries(every)
        .filter(([, verdict]) => verdict === wanted)
        .map(([key]) => intervalOf(key));
    return { of: (hit) => every[keyOf(hit)], set, clear, accepted: side("yes"), rejected: side("no") };
  }, [every, set, clear]);
}
