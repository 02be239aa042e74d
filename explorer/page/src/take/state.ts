// The state of the page of a take: the session, and what of it is in the address.

import { useCallback, useEffect, useMemo, useRef } from "react";
import { useSearch } from "wouter";

import { useJsonParameter, useParameter, useParameters } from "../app/address";
import { colours } from "../motion/colours";
import { CLOSED } from "./rows";
import { Session } from "./session";
import type { Lane, Segment, TakeDocument, TakeTemplates } from "./types";

/** Return the session of a take, begun where the address says, and write its rests into the address. */
export function useSession(document: TakeDocument): Session {
  const search = useSearch();
  const set = useParameters();
  const session = useMemo(() => {
    const made = new Session(document.frames, document.rate_hz);
    applyAddress(made, window.location.search, true);
    return made;
  }, [document.frames, document.rate_hz]);
  const written = useRef(placeOf(search));
  useEffect(
    () =>
      session.onRest(() => {
        const { selection } = session.shown;
        const frame = Math.floor(session.frame);
        set({
          from: selection === null ? null : String(selection[0]),
          to: selection === null ? null : String(selection[1]),
          frame: frame === 0 ? null : String(frame),
        });
        written.current = placeOf(window.location.search);
      }),
    [session, set],
  );
  useEffect(() => {
    if (placeOf(search) === written.current) return;
    written.current = placeOf(search);
    applyAddress(session, search, false);
  }, [session, search]);
  useEffect(() => () => session.end(), [session]);
  return session;
}

/** Return the part of an address that is about playhead and selection. */
function placeOf(search: string): string {
  const parameters = new URLSearchParams(search);
  return ["from", "to", "frame"].map((name) => parameters.get(name) ?? "").join(" ");
}

function applyAddress(session: Session, search: string, begin: boolean): void {
  const parameters = new URLSearchParams(search);
  const number = (name: string) => {
    const value = Number.parseInt(parameters.get(name) ?? "", 10);
    return Number.isFinite(value) ? Math.min(Math.max(0, value), session.frames) : null;
  };
  const [from, to, frame] = [number("from"), number("to"), number("frame")];
  const selection = from !== null && to !== null && from < to ? ([from, to] as const) : null;
  const now = session.shown.selection;
  if (selection?.[0] !== now?.[0] || selection?.[1] !== now?.[1]) session.select(selection);
  const at = frame ?? (begin ? from : null);
  if (at !== null && at !== Math.floor(session.frame)) session.seek(at);
  if (begin && selection !== null && selection[1] - selection[0] < session.frames / 20) {
    const margin = 2 * (selection[1] - selection[0]);
    session.setView({ from: selection[0] - margin, to: selection[1] + margin });
  }
}

/** Return the groups of lanes that are closed, as the address has them. */
export function useClosed(): [ReadonlySet<string>, (id: string) => void] {
  const [list, set] = useJsonParameter<readonly string[]>("closed", CLOSED);
  const text = JSON.stringify(list);
  const closed = useMemo(() => new Set(JSON.parse(text) as string[]), [text]);
  const toggle = useCallback(
    (id: string) => {
      const next = new Set(closed);
      if (!next.delete(id)) next.add(id);
      set([...next].sort());
    },
    [closed, set],
  );
  return [closed, toggle];
}

/** Return the templates whose curves are shown: those of the address, or the two found most often. */
export function useTemplateNames(offered: TakeTemplates | undefined): [readonly string[], (names: string[]) => void] {
  const [text, set] = useParameter("templates");
  const names = useMemo(() => {
    if (text === null) return offered?.found.slice(0, 2) ?? [];
    return text === "none" ? [] : text.split(",").map(decodeURIComponent);
  }, [text, offered]);
  const change = useCallback(
    (next: string[]) => set(next.length === 0 ? "none" : next.map(encodeURIComponent).join(","), true),
    [set],
  );
  return [names, change];
}

/** Return the template and the frame that somebody has clicked, as the address has them. */
export function usePicked(): [{ name: string; frame: number } | null, (name: string | null, frame?: number) => void] {
  const [text, set] = useParameter("pick");
  const picked = useMemo(() => {
    const cut = text?.lastIndexOf("@") ?? -1;
    if (text === null || cut < 0) return null;
    const frame = Number.parseInt(text.slice(cut + 1), 10);
    return Number.isFinite(frame) ? { name: text.slice(0, cut), frame } : null;
  }, [text]);
  const pick = useCallback(
    (name: string | null, frame = 0) => set(name === null ? null : `${name}@${frame}`),
    [set],
  );
  return [picked, pick];
}

/** Return the colour of a segment by its class; classes are sorted, so that colours do not depend on the order. */
export function useClassColours(lanes: readonly Lane[]): (segment: Segment) => string {
  return useMemo(() => {
    const names = new Set(lanes.flatMap((lane) => lane.segments.map((one) => one.class ?? "")));
    const place = new Map([...names].sort().map((name, i) => [name, i]));
    return (segment) => {
      const { classes, muted } = colours();
      const i = place.get(segment.class ?? "");
      return i === undefined ? muted : (classes[i % classes.length] ?? muted);
    };
  }, [lanes]);
}

export function segmentStarts(lanes: readonly Lane[]): number[] {
  const starts = lanes
    .filter((lane) => ["labels", "ground_truth", "annotations", "hits"].includes(lane.group))
    .flatMap((lane) => lane.segments.map((one) => one.start));
  return [...new Set(starts)].sort((a, b) => a - b);
}
