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

/** Open the stream for as long as the page is open; call it once. */
export function useEvents(): void {
  useEffect(() => {
    const source = new EventSource("/api/events");
    source.addEventListener("version", () => void queries.invalidateQueries({ queryKey: ["version"] }));
    source.addEventListener("labels", () => void queries.invalidateQueries({ queryKey: ["labels"] }));
    source.addEventListener("job", (event) => {
      const job = JSON.parse((event as MessageEvent<string>).data) as Job;
      jobs.set(job.id, job);
      changed();
    });
    source.onopen = () => {
      if (!connected) void queries.invalidateQueries();
      connected = true;
      changed();
    };
    source.onerror = () => {
      connected = false;
      changed();
    };
    return () => source.close();
  }, []);
}

export function useJobs(): Job[] {
  return useSyncExternalStore(subscribe, () => shown);
}

export function useConnected(): boolean {
  return useSyncExternalStore(subscribe, () => connected);
}
