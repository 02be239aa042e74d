// Keys of the page. A component registers its shortcuts while it is shown; `?` lists all that work now.

import { useEffect, useRef, useSyncExternalStore } from "react";

export interface Shortcut {
  /** One key as KeyboardEvent.key has it, "mod+z" (Ctrl, or ⌘ on a Mac), or two keys one after the other: "g a". */
  keys: string;
  what: string;
  run: (event: KeyboardEvent) => void;
}

interface Group {
  title: string;
  shortcuts: readonly Shortcut[];
}

const groups = new Set<{ current: Group }>();
const listeners = new Set<() => void>();
let shown: Group[] = [];
let pending = "";
let pendingSince = 0;
const PAIR_MS = 1200;

function changed(): void {
  shown = [...groups].map((one) => one.current);
  for (const listener of listeners) listener();
}

/** Register shortcuts for as long as the component is there; those registered last win. */
export function useShortcuts(title: string, shortcuts: readonly Shortcut[]): void {
  const group = useRef<Group>({ title, shortcuts });
  group.current = { title, shortcuts };
  useEffect(() => {
    groups.add(group);
    changed();
    return () => {
      groups.delete(group);
      changed();
    };
  }, []);
}

export function useShownShortcuts(): Group[] {
  return useSyncExternalStore(
    (listener) => {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
    () => shown,
  );
}

/** Return whether the keys of an event go into a text that is being edited. */
export function isTyping(target: EventTarget | null): boolean {
  return (
    target instanceof HTMLElement &&
    (target.isContentEditable ||
      target instanceof HTMLTextAreaElement ||
      target instanceof HTMLSelectElement ||
      (target instanceof HTMLInputElement && !["checkbox", "radio", "range", "button"].includes(target.type)))
  );
}

export function keysOf(event: Pick<KeyboardEvent, "key" | "ctrlKey" | "metaKey" | "altKey">): string {
  if (event.altKey) return `alt+${event.key}`;
  return event.ctrlKey || event.metaKey ? `mod+${event.key.toLowerCase()}` : event.key;
}

function onKey(event: KeyboardEvent): void {
  if (event.defaultPrevented || isTyping(event.target)) return;
  if (document.querySelector('[role="dialog"][aria-modal="true"]') !== null) return;
  const keys = keysOf(event);
  const pair = event.timeStamp - pendingSince < PAIR_MS ? `${pending} ${keys}` : "";
  for (const group of [...groups].reverse()) {
    const found = group.current.shortcuts.find((one) => one.keys === pair || one.keys === keys);
    if (found !== undefined) {
      pending = "";
      event.preventDefault();
      found.run(event);
      return;
    }
  }
  pending = keys;
  pendingSince = event.timeStamp;
}

window.addEventListener("keydown", onKey);
