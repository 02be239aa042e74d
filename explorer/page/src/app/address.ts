// State in the address: what a page shows is in its query string, so that a link opens the same view.

import { useCallback, useMemo } from "react";
import { useLocation, useSearch } from "wouter";

/** Return the value of a parameter of the address, and a function that sets it.
 *
 * A null removes the parameter. `push` makes an entry in the history of the browser; without it the entry is replaced,
 * as it should be while somebody types, scrolls or drags. */
export function useParameter(name: string): [string | null, (value: string | null, push?: boolean) => void] {
  const search = useSearch();
  // `search` tells of changes alone: it is decoded already, and a percent sign in a value would be decoded twice
  const value = useMemo(() => new URLSearchParams(window.location.search).get(name), [search, name]);
  const change = useParameters();
  const set = useCallback(
    (next: string | null, push = false) => change({ [name]: next }, push),
    [change, name],
  );
  return [value, set];
}

/** Return a function that sets several parameters of the address in one step. */
export function useParameters(): (values: Record<string, string | null>, push?: boolean) => void {
  const [, navigate] = useLocation();
  return useCallback(
    (values, push = false) => {
      const parameters = new URLSearchParams(window.location.search);
      for (const [name, value] of Object.entries(values)) {
        if (value === null || value === "") parameters.delete(name);
        else parameters.set(name, value);
      }
      const text = parameters.toString();
      if (text !== window.location.search.replace(/^\?/, ""))
        navigate(window.location.pathname + (text === "" ? "" : `?${text}`), { replace: !push });
    },
    [navigate],
  );
}

/** Return the value of a parameter that holds JSON, and a function that sets it.
 *
 * What is no JSON counts as absent, and so does what is no list where a list belongs. */
export function useJsonParameter<T>(name: string, absent: T): [T, (value: T | null, push?: boolean) => void] {
  const [text, set] = useParameter(name);
  const value = useMemo(() => parsed(text, absent), [text, absent]);
  const change = useCallback(
    (next: T | null, push = false) => set(next === null ? null : JSON.stringify(next), push),
    [set],
  );
  return [value, change];
}

function parsed<T>(text: string | null, absent: T): T {
  if (text === null) return absent;
  try {
    const value = JSON.parse(text) as T;
    return Array.isArray(absent) && !Array.isArray(value) ? absent : value;
  } catch {
    return absent;
  }
}

/** Return the address of a take, with an interval if one is given. */
export function takeAddress(name: string, from?: number, to?: number): string {
  const interval = from === undefined || to === undefined ? "" : `?from=${from}&to=${to}`;
  return `/take/${encodeURIComponent(name)}${interval}`;
}

/** Return the name of the take in the path of an address, null where there is none. */
export function takeName(path: string): string | null {
  const [, page, name = ""] = path.split("/");
  if (page !== "take" || name === "") return null;
  try {
    return decodeURIComponent(name);
  } catch {
    return name; // no address that this page has made
  }
}
