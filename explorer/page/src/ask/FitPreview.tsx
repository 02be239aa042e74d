// How the hit under the pointer fits: its cost along the take and its warping path, beside the hit. The pointer has to
// rest for a moment, so that a way across the grid asks for nothing; what was asked once is kept.

import { Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useEffect, useState } from "react";

import { shownSeconds } from "../api/seconds";
import { type Explain, FitCurve, FitPath } from "./Details";
import { type Hit, keyOf } from "./types";

const REST_MS = 120;
const WIDTH = 220;
const HEIGHT = 190;

export interface FitPreviewProps {
  hit: Hit;
  /** The cell that it stands at. */
  cell: HTMLElement;
  rateHz: number;
  explain: Explain;
}

export function FitPreview({ hit, cell, rateHz, explain }: FitPreviewProps) {
  const [rested, setRested] = useState(false);
  useEffect(() => {
    const timer = setTimeout(() => setRested(true), REST_MS);
    return () => clearTimeout(timer);
  }, []);
  const fit = useQuery({
    queryKey: ["version", "ask-hit", explain.key, keyOf(hit)],
    queryFn: ({ signal }) => explain.load(hit, signal),
    enabled: rested,
  });
  if (!rested || fit.data === undefined) return null;
  const below = cell.getBoundingClientRect().bottom + HEIGHT < window.innerHeight;
  const room = (cell.offsetParent?.clientWidth ?? WIDTH) - WIDTH;
  const left = Math.max(0, Math.min(room, cell.offsetLeft + (cell.offsetWidth - WIDTH) / 2));
  const top = below ? cell.offsetTop + cell.offsetHeight + 2 : cell.offsetTop - HEIGHT - 2;
  return (
    <div className="fit-preview" style={{ left, top, width: WIDTH, height: HEIGHT }} aria-hidden="true">
      <Text size="xs" truncate>
        {hit.take}, {shownSeconds(hit.start, rateHz)} to {shownSeconds(hit.stop, rateHz)} s
      </Text>
      <FitCurve fit={fit.data} hit={hit} rateHz={rateHz} />
      <FitPath fit={fit.data} hit={hit} />
    </div>
  );
}
