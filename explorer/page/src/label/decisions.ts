// The decisions of this tab on their way to the server. A decision is shown at once, kept in the browser until the server
// has answered that it is on disk, sent again where the connection is lost, and reported where the server refuses it.

import { useSyncExternalStore } from "react";

import { ApiError, post } from "../api/client";
import { queries } from "../api/queries";
import type { Same } from "../api/types";
import { showSame } from "../app/same";
import { type Change, type LabelRow, madeBy, newId, replacedBy } from "./edits";

export interface Decision {
  id: string;
  take: string;
  annotator: string;
  changes: Change[];
  /** Whether it undoes an edit of `steps` or does it again. */
  way?: "undo" | "redo";
  /** The labels that it makes count no more, if it does. */
  before?: string[];
}

export interface Refused {
  decision: Decision;
  message: string;
}

export interface State {
  pending: readonly Decision[];
  refused: readonly Refused[];
  /** Why decisions wait; empty while the server answers. */
  trouble: string;
  saved: number;
  undo: readonly Step[];
  redo: readonly Step[];
}

/** An edit that can be undone: the rows that it made, and the labels that count again without it. */
export interface Step {
  take: string;
  made: string[];
  back: string[];
}

interface Answer extends Same {
  made: string[];
  restored: Record<string, string>;
  rows: LabelRow[];
}

interface TakeRows {
  rows: LabelRow[];
}

const PREFIX = "kinedex-decisions:";
const MAX_STEPS = 5000;
const RETRY_MS = [500, 1000, 2000, 5000];

const listeners = new Set<() => void>();
let state: State = { pending: [], refused: [], trouble: "", saved: 0, undo: [], redo: [] };
let place = "";
let sending = false;
let wanted: { way: "undo" | "redo"; annotator: string }[] = [];
let tries = 0;

function set(values: Partial<State>): void {
  state = { ...state, ...values };
  keep();
  for (const listener of listeners) listener();
}

/** Keep what is not saved yet beyond the life of the tab, and the steps for as long as the tab lives. */
function keep(): void {
  if (place === "") return;
  try {
    if (state.pending.length > 0) localStorage.setItem(place, JSON.stringify(state.pending));
    else localStorage.removeItem(place);
    sessionStorage.setItem(`${place}:steps`, JSON.stringify([state.undo, state.redo]));
  } catch {
    // without storage decisions are kept as long as the page is open
  }
}

/** Take over the decisions of a store that this tab, or one that was closed, could not save. */
export function openDecisions(store: string): void {
  const prefix = `${PREFIX}${store}:`;
  if (place.startsWith(prefix)) return;
  const tab = read<string>(sessionStorage, "kinedex-tab", newId());
  write(sessionStorage, "kinedex-tab", tab);
  place = `${prefix}${tab}`;
  const pending: Decision[] = [];
  try {
    for (const key of Object.keys(localStorage).filter((one) => one.startsWith(prefix))) {
      pending.push(...read<Decision[]>(localStorage, key, []));
      if (key !== place) localStorage.removeItem(key);
    }
  } catch {
    // no storage
  }
  const [undo, redo] = read<[Step[], Step[]]>(sessionStorage, `${place}:steps`, [[], []]);
  set({ pending, undo, redo });
  void send();
}

function read<T>(storage: Storage, key: string, absent: T): T {
  try {
    const text = storage.getItem(key);
    return text === null ? absent : (JSON.parse(text) as T);
  } catch {
    return absent;
  }
}

function write(storage: Storage, key: string, value: unknown): void {
  try {
    storage.setItem(key, JSON.stringify(value));
  } catch {
    // no storage
  }
}

export function annotatorName(absent: string): string {
  return read(localStorage, "kinedex-annotator", absent);
}

export function setAnnotatorName(name: string): void {
  write(localStorage, "kinedex-annotator", name);
}

/** Make edits of the labels of a take; they are one step for undo. */
export function decide(take: string, changes: Change[], annotator: string): void {
  if (changes.length === 0) return;
  const decision = { id: newId(), take, annotator, changes };
  const step = { take, made: madeBy(changes), back: replacedBy(changes) };
  set({ pending: [...state.pending, decision], undo: [...state.undo, step].slice(-MAX_STEPS), redo: [] });
  void send();
}

/** Undo the last edit of this tab, or do the last undone one again; one after the other, since an undo makes new ids. */
export function step(way: "undo" | "redo", annotator: string): void {
  if (state.pending.some((one) => one.way !== undefined)) {
    wanted.push({ way, annotator });
    return;
  }
  const last = state[way].at(-1);
  if (last === undefined) return;
  const { take, made, back } = last;
  const ids = Array.from({ length: made.length + back.length }, newId);
  const change: Change = { do: "restore", ids, made, back };
  const decision = { id: newId(), take, annotator, changes: [change], way, before: made };
  set({ pending: [...state.pending, decision], [way]: state[way].slice(0, -1) });
  void send();
}

export function dismiss(refused: Refused): void {
  set({ refused: state.refused.filter((one) => one !== refused) });
}

export function retryNow(): void {
  tries = 0;
  void send();
}

async function send(): Promise<void> {
  if (sending) return;
  sending = true;
  try {
    while (state.pending[0] !== undefined) {
      if (!(await sendOne(state.pending[0]))) break;
      const next = state.pending.length === 0 ? wanted.shift() : undefined;
      if (next !== undefined) step(next.way, next.annotator);
    }
  } finally {
    sending = false;
  }
}

/** Send a decision; false where it has to wait. */
async function sendOne(decision: Decision): Promise<boolean> {
  const { take, annotator, changes } = decision;
  try {
    const answer = await post<Answer>("/api/labels/decide", { take, annotator, changes });
    tries = 0;
    queries.setQueriesData<TakeRows>({ queryKey: ["labels", "of-take", take] }, (old) => old && withRows(old, answer.rows));
    if (answer.command !== undefined) showSame(answer);
    set({ pending: state.pending.slice(1), trouble: "", saved: state.saved + 1, ...stepsAfter(decision, answer) });
    return true;
  } catch (fault) {
    const message = fault instanceof Error ? fault.message : String(fault);
    if (fault instanceof ApiError && fault.status >= 400 && fault.status < 500 && fault.status !== 401 && fault.status !== 408) {
      wanted = [];
      set({ pending: state.pending.slice(1), refused: [...state.refused, { decision, message }], ...stepsWithout(decision) });
      void queries.invalidateQueries({ queryKey: ["labels"] });
      return true;
    }
    set({ trouble: message });
    setTimeout(() => void send(), RETRY_MS[Math.min(tries++, RETRY_MS.length - 1)]);
    return false;
  }
}

function withRows<T extends TakeRows>(old: T, rows: readonly LabelRow[]): T {
  const known = new Set(old.rows.map((row) => row.id));
  return { ...old, rows: [...old.rows, ...rows.filter((row) => !known.has(row.id))] };
}

/** Return the steps after an answer: an undone edit can be done again, and labels that count again have new ids. */
function stepsAfter({ way, changes, take, before = [] }: Decision, { made, restored }: Answer): Partial<State> {
  if (way === undefined) {
    const expected = madeBy(changes);
    if (made.length >= expected.length) return {};
    // an annotation that had been decided so before makes no row: there is nothing to undo of it
    const known = new Set(made);
    const gone = new Set(expected.filter((one) => !known.has(one)));
    const undo = state.undo.map((one) => ({ ...one, made: one.made.filter((id) => !gone.has(id)) }));
    return { undo: undo.filter((one) => one.made.length > 0) };
  }
  const renamed = (steps: readonly Step[]) =>
    steps.map((one) => ({ ...one, made: one.made.map((id) => restored[id] ?? id) }));
  const [undo, redo] = [renamed(state.undo), renamed(state.redo)];
  const done = { take, made, back: before };
  return way === "undo" ? { undo, redo: [...redo, done] } : { undo: [...undo, done], redo };
}

function stepsWithout({ way, changes }: Decision): Partial<State> {
  if (way !== undefined) return {};
  const made = new Set(madeBy(changes));
  return { undo: state.undo.filter((one) => !one.made.some((id) => made.has(id))) };
}

export function useDecisions(): State {
  return useSyncExternalStore(
    (listener) => {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
    () => state,
  );
}

/** Warn before the page is left while decisions are not saved: they would be sent when it is opened again. */
window.addEventListener("beforeunload", (event) => {
  if (state.pending.length > 0) event.preventDefault();
});
