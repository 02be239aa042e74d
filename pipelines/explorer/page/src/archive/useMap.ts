// Questions of the map to the server: the map itself, which arrives after a while, and values of its takes.

import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useState } from "react";

import { ApiError, getStream, post } from "../api/client";
import { readLines, type Step } from "../api/lines";
import type { Selection } from "../api/types";
import type { ArchiveMap, MapTakes, Unit } from "./map";

interface Line extends Partial<Step> {
  map?: ArchiveMap;
  error?: { type: string; message: string };
}

/** Return the map of the archive, and how far the server is with it. Who leaves the page no longer waits for it. */
export function useMap(unit: Unit) {
  const [step, setStep] = useState<Step>({ done: 0, total: 0 });
  const found = useQuery({
    queryKey: ["version", "map", unit],
    queryFn: async ({ signal }) => {
      setStep({ done: 0, total: 0 });
      return readMap(await getStream(`/api/map?unit=${unit}`, signal), setStep);
    },
    gcTime: 600_000,
  });
  return { map: found.data, fault: found.error, retry: () => void found.refetch(), step };
}

/** Read lines of JSON until the one with the map. */
async function readMap(stream: ReadableStream<Uint8Array>, onStep: (step: Step) => void): Promise<ArchiveMap> {
  for await (const text of readLines(stream)) {
    const line = JSON.parse(text) as Line;
    if (line.error !== undefined) throw new ApiError(400, line.error.type, line.error.message);
    if (line.map !== undefined) return line.map;
    onStep({ done: line.done ?? 0, total: line.total ?? 0 });
  }
  throw new ApiError(0, "ConnectionError", "the server stopped before the map was there");
}

/** Return the values of a column of the takes that fit. */
export function useMapTakes(selection: Selection, column: string) {
  return useQuery({
    queryKey: ["version", "map-takes", selection, column],
    queryFn: ({ signal }) => post<MapTakes>("/api/map/takes", { ...selection, column }, signal),
    placeholderData: keepPreviousData,
  });
}
