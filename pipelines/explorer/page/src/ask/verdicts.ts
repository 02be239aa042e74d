// Hits that a person has accepted or rejected. They are kept in the session of the tab until they are saved, so that a
// reload, or a visit to another page, costs none. Those of another question (its scope) are not shown, nor saved with it.

import { createContext, useCallback, useContext, useMemo, useSyncExternalStore } from "react";

import { type Hit, type Interval, intervalOf, keyOf } from "./types";

export type Verdict = "yes" | "no";

const PLACE = "kinedex-ask-verdicts";
const listeners = new Set<() => void>();
type Held = Readonly<Record<string, Readonly<Record<string, Verdict>>>>;
const NONE = {};
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
  of: (hit: Interval) => Verdict | undefined;
  set: (hit: Hit, verdict: Verdict | null) => void;
  clear: () => void;
  accepted: Interval[];
  rejected: Interval[];
}

const Scope = createContext("");

/** The question that verdicts belong to. */
export const VerdictScope = Scope.Provider;

export function useVerdicts(): Verdicts {
  const scope = useContext(Scope);
  const every = useSyncExternalStore(subscribe, () => held[scope] ?? NONE) as Readonly<Record<string, Verdict>>;
  const set = useCallback(
    (hit: Hit, verdict: Verdict | null) => {
      const next: Record<string, Verdict> = { ...held[scope] };
      const key = keyOf(hit);
      if (verdict === null) delete next[key];
      else next[key] = verdict;
      write({ ...held, [scope]: next });
    },
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
    return { of: (hit) => every[keyOf(hit)], set, clear, accepted: side("yes"), rejected: side("no") };
  }, [every, set, clear]);
}
