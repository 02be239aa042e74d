// The stream of events of the server: newer versions, labels, jobs.

import { useEffect, useSyncExternalStore } from "react";

import { queries } from "./queries";
import type { Job } from "./types";

const jobs = new Map<string, Job>();
const listeners = new Set<() => void>();
let shown: Job[] = [];
let connected = true;

function changed(): void {
  shown = [...jobs.values()];
  for (const listener of listeners) listener();
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

let state: { version: number; labels: string } | null = null;

/** Take in what the store is now, and ask again for what has changed since this page listened last. */
function compare(next: { version: number; labels: string }): void {
  if (state !== null && state.version !== next.version) void queries.invalidateQueries({ queryKey: ["version"] });
  if (state !== null && state.labels !== next.labels) void queries.invalidateQueries({ queryKey: ["labels"] });
  state = next;
  jobs.clear(); // those that still run follow
  connected = true;
  changed();
}

function open(): EventSource {
  const source = new EventSource("/api/events");
  const on = <T>(kind: string, take: (message: T) => void) =>
    source.addEventListener(kind, (event) => take(JSON.parse((event as MessageEvent<string>).data) as T));
  on("state", compare);
  on<{ version: number }>("version", ({ version }) => {
    if (state !== null) state = { ...state, version };
    void queries.invalidateQueries({ queryKey: ["version"] });
  });
  on("labels", () => void queries.invalidateQueries({ queryKey: ["labels"] }));
  on<Job>("job", (job) => {
    jobs.set(job.id, job);
    changed();
  });
  source.onerror = () => {
    connected = false;
    changed();
  };
  return source;
}

/** Listen to the stream while the page is in sight; call it once.
 *
 * A browser opens six connections to a server at most, and every stream holds one: hidden tabs let go of theirs. */
export function useEvents(): void {
  useEffect(() => {
    let source: EventSource | null = null;
    const turn = () => {
      if (document.visibilityState === "visible") source ??= open();
      else {
        source?.close();
        source = null;
      }
    };
    turn();
    document.addEventListener("visibilitychange", turn);
    return () => {
      document.removeEventListener("visibilitychange", turn);
      source?.close();
    };
  }, []);
}

export function useJobs(): Job[] {
  return useSyncExternalStore(subscribe, () => shown);
}

export function useConnected(): boolean {
  return useSyncExternalStore(subscribe, () => connected);
}
