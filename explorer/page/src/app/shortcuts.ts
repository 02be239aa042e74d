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
  const taken = new Set<string>(); // keys that a later group uses for something else are not listed twice
  const found: Group[] = [];
  for (const { current } of [...groups].reverse()) {
    const shortcuts = current.shortcuts.filter((one) => !taken.has(one.keys));
    for (const one of shortcuts) taken.add(one.keys);
    if (shortcuts.length > 0) found.unshift({ ...current, shortcuts });
  }
  shown = found;
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

/** Return whether an element has a use of its own for a key: buttons for space and Enter, radio buttons for arrows. */
export function usesKey(target: EventTarget | null, key: string): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (key === " " || key === "Enter")
    return target.closest('button, a[href], summary, input, [role="button"], [role="switch"], [role="option"]') !== null;
  return key.startsWith("Arrow") && target instanceof HTMLInputElement && target.type === "radio";
}

export function keysOf(event: Pick<KeyboardEvent, "key" | "ctrlKey" | "metaKey" | "altKey">): string {
  if (event.altKey) return `alt+${event.key}`;
  return event.ctrlKey || event.metaKey ? `mod+${event.key.toLowerCase()}` : event.key;
}

/** Return the shortcut of some keys; of several the one registered last. */
function findShortcut(keys: string): Shortcut | undefined {
  if (keys === "") return undefined;
  for (const group of [...groups].reverse()) {
    const found = group.current.shortcuts.find((one) => one.keys === keys);
    if (found !== undefined) return found;
  }
  return undefined;
}

const NAMES: Record<string, string> = {
  " ": "Space",
  ArrowLeft: "←",
  ArrowRight: "→",
  ArrowUp: "↑",
  ArrowDown: "↓",
  Escape: "Esc",
  PageUp: "Page Up",
  PageDown: "Page Down",
};

/** Return keys as a list of keys shows them. */
export function keyNames(keys: string): string {
  return NAMES[keys] ?? keys.replace("mod+", "Ctrl+").replace("alt+", "Alt+");
}

function onKey(event: KeyboardEvent): void {
  if (event.defaultPrevented || isTyping(event.target) || usesKey(event.target, event.key)) return;
  if (document.querySelector('[role="dialog"][aria-modal="true"]') !== null) return;
  const keys = keysOf(event);
  const pair = event.timeStamp - pendingSince < PAIR_MS ? `${pending} ${keys}` : "";
  const found = findShortcut(pair) ?? findShortcut(keys);
  if (found !== undefined) {
    pending = "";
    event.preventDefault();
    found.run(event);
    return;
  }
  pending = keys;
  pendingSince = event.timeStamp;
}

window.addEventListener("keydown", onKey);
