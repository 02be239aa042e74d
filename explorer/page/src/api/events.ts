// The stream of events of the server: newer versions, labels, jobs.

import { useEffect, useSyncExternalStore } from "react";

import { ApiError, get } from "./client";
import { queries } from "./queries";
import type { Job } from "./types";

const jobs = new Map<string, Job>();
const listeners = new Set<() => void>();
let shown: Job[] = [];
/** Why no messages come, or why the store cannot be read; empty while all is well. */
let trouble = "";

const AWAY = "no connection to the server";
const ANEW = "the server was started anew: open the address that it printed";
const UNREADABLE = "the store cannot be read";
const REOPEN_MS = 3000;

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
  changed();
}

/** Report what is wrong with the server or the store; once all is well, ask again for what has failed meanwhile. */
function tell(next: string): void {
  if (next === trouble) return;
  trouble = next;
  if (next === "") void queries.invalidateQueries({ predicate: (query) => query.state.status === "error" });
  changed();
}

/** Tell a server that is away from one that does not know this page any more. */
function ask(): void {
  get("/api/store").then(
    () => tell(AWAY),
    (fault: unknown) => tell(fault instanceof ApiError && fault.status === 401 ? ANEW : AWAY),
  );
}

/** Open the stream; `ended` is called where the answer was none, and the browser does not try again by itself. */
function open(ended: () => void): EventSource {
  const source = new EventSource("/api/events");
  const on = <T>(kind: string, take: (message: T) => void) =>
    source.addEventListener(kind, (event) => take(JSON.parse((event as MessageEvent<string>).data) as T));
  on<{ version: number; labels: string }>("state", (next) => {
    tell("");
    compare(next);
  });
  on("trouble", () => tell(UNREADABLE)); // what is asked of the store says why
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
    if (source.readyState === EventSource.CLOSED) ended();
    else tell(AWAY);
  };
  return source;
}

/** Listen to the stream while the page is in sight; call it once.
 *
 * A browser opens six connections to a server at most, and every stream holds one: hidden tabs let go of theirs. */
export function useEvents(): void {
  useEffect(() => {
    let source: EventSource | null = null;
    let timer = 0;
    const ended = () => {
      source = null;
      ask();
      timer = window.setTimeout(turn, REOPEN_MS);
    };
    const turn = () => {
      window.clearTimeout(timer);
      if (document.visibilityState === "visible") source ??= open(ended);
      else {
        source?.close();
        source = null;
      }
    };
    turn();
    document.addEventListener("visibilitychange", turn);
    return () => {
      document.removeEventListener("visibilitychange", turn);
      window.clearTimeout(timer);
      source?.close();
    };
  }, []);
}

export function useJobs(): Job[] {
  return useSyncExternalStore(subscribe, () => shown);
}

/** Return what is wrong with the server or the store; empty while all is well. */
export function useTrouble(): string {
  return useSyncExternalStore(subscribe, () => trouble);
}
