// Questions of the map to the server: the map itself, which arrives after a while, and values of its takes.

import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useState } from "react";

import { getLines, post } from "../api/client";
import type { Step } from "../api/lines";
import type { Selection } from "../api/types";
import type { ArchiveMap, MapTakes, Unit } from "./map";

/** Return the map of the archive, and how far the server is with it. Who leaves the page no longer waits for it. */
export function useMap(unit: Unit) {
  const [step, setStep] = useState<Step>({ done: 0, total: 0 });
  const found = useQuery({
    queryKey: ["version", "map", unit],
    queryFn: async ({ signal }) => {
      setStep({ done: 0, total: 0 });
      return getLines<ArchiveMap>(`/api/map?unit=${unit}`, setStep, signal);
    },
    gcTime: 600_000,
  });
  return { map: found.data, fault: found.error, retry: () => void found.refetch(), step };
}

/** Return the values of a column of the takes that fit. */
export function useMapTakes(selection: Selection, column: string) {
  return useQuery({
    queryKey: ["version", "map-takes", selection, column],
    queryFn: ({ signal }) => post<MapTakes>("/api/map/takes", { ...selection, column }, signal),
    placeholderData: keepPreviousData,
  });
}
