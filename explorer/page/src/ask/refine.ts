// The next question after hits of a way to ask that has no example: by the accepted hits, in contrast to the rejected ones.

import { useCallback } from "react";

import { useParameters } from "../app/address";
import { type Interval, packed } from "./types";
import { originOf } from "./verdicts";

/** Return a function that asks by example, with the verdicts on the hits of a way to ask. */
export function useRefine(way: string): (accepted: Interval[], rejected: Interval[]) => void {
  const set = useParameters();
  return useCallback(
    (accepted, rejected) =>
      set(
        {
          way: null,
          more: JSON.stringify(accepted.map(packed)),
          less: rejected.length === 0 ? null : JSON.stringify(rejected.map(packed)),
          of: originOf(way),
          take: null,
          from: null,
          to: null,
        },
        true,
      ),
    [set, way],
  );
}
