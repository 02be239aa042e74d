// The command and the Python lines that do the same as what is shown; the bar at the bottom shows them.

import { useEffect, useSyncExternalStore } from "react";

import type { Same } from "../api/types";

let current: Same = {};
const listeners = new Set<() => void>();

/** Show the command of something that was just done, until the page shows something else. */
export function showSame({ command, python }: Same): void {
  current = { command, python };
  for (const listener of listeners) listener();
}

/** Show the command of an answer for as long as the component is there. */
export function useSame(same: Same | undefined): void {
  const { command, python } = same ?? {};
  useEffect(() => {
    showSame({ command, python });
    return () => showSame({});
  }, [command, python]);
}

export function useShownSame(): Same {
  return useSyncExternalStore(
    (listener) => {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
    () => current,
  );
}
