// What a page of a take asks the server for: the motion as a stream, words, lanes, curves.

import { useQueries, useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useState } from "react";

import { get, getBytes, getStream } from "../api/client";
import { Motion, readBlocks } from "../motion/motion";
import type { CurveRow } from "./rows";
import type { Session } from "./session";
import type { ErrorLimb, FittedHit, TakeDocument, TakeLanes, TakeTemplates, TemplateImage } from "./types";
import { Words } from "./words";

const path = (id: number, rest = "") => `/api/takes/${id}${rest}`;

export function useDocument(name: string | null) {
  return useQuery({
    queryKey: ["version", "take", name],
    queryFn: ({ signal }) => get<TakeDocument>(`/api/take?name=${encodeURIComponent(name ?? "")}`, signal),
    enabled: name !== null && name !== "",
  });
}

/** Return the motion of a take, whose poses arrive while it is shown, and why it did not arrive. */
export function useMotion(
  id: number | null,
  version: number,
  session: Session,
): { motion: Motion; fault: unknown; whole: boolean } {
  const motion = useMemo(() => new Motion(), [id, version]);
  const [fault, setFault] = useState<unknown>(null);
  const [whole, setWhole] = useState(false);
  useEffect(() => {
    if (id === null) return;
    const stop = new AbortController();
    setFault(null);
    setWhole(false);
    load(id, motion, session, stop.signal).then(
      () => !stop.signal.aborted && setWhole(true),
      (reason: unknown) => !stop.signal.aborted && setFault(reason),
    );
    return () => stop.abort();
  }, [id, motion, session]);
  return { motion, fault, whole };
}

/** Return the motions of several takes, and why one of them did not arrive. */
export function useMotions(ids: readonly number[], session: Session): { motions: Motion[]; fault: unknown } {
  const [fault, setFault] = useState<unknown>(null);
  const key = ids.join(" ");
  const motions = useMemo(() => ids.map(() => new Motion()), [key]);
  useEffect(() => {
    const stop = new AbortController();
    setFault(null);
    ids.forEach((id, i) => {
      load(id, motions[i] as Motion, session, stop.signal).catch((reason: unknown) => {
        if (!stop.signal.aborted) setFault(reason);
      });
    });
    return () => stop.abort();
  }, [motions, session]);
  return { motions, fault };
}

/** Add the poses of a take to a motion as they arrive. */
async function load(id: number, motion: Motion, session: Session, signal: AbortSignal): Promise<void> {
  try {
    await readBlocks(await getStream(path(id, "/motion"), signal), (block) => {
      if (signal.aborted) return;
      motion.add(block);
      session.changed("content");
      session.begin();
    });
  } finally {
    session.begin();
  }
}

export function useWords(id: number, version: number, features: number) {
  const bytes = useQuery({
    queryKey: ["version", "words", id, version],
    queryFn: ({ signal }) => getBytes(path(id, "/words"), signal),
  });
  const words = useMemo(
    () => (bytes.data === undefined ? null : new Words(bytes.data, features)),
    [bytes.data, features],
  );
  return { words, fault: bytes.error };
}

// Lanes and templates wait for the first poses: they take the server longer, and would keep it from sending those.

export function useLanes(id: number, version: number, session: Session) {
  return useQuery({
    queryKey: ["labels", "lanes", id, version],
    queryFn: ({ signal }) => session.begun.then(() => get<TakeLanes>(path(id, "/lanes"), signal)),
  });
}

export function useTemplates(id: number, version: number, session: Session) {
  return useQuery({
    queryKey: ["version", "templates", id, version],
    queryFn: ({ signal }) => session.begun.then(() => get<TakeTemplates>(path(id, "/templates"), signal)),
  });
}

/** Return the address of a question about a template of a take. */
function about(name: string, offered: TakeTemplates): string {
  const found = offered.templates.find((one) => one.name === name);
  const stage = found === undefined ? "" : `&stage=${encodeURIComponent(found.stage)}&kind=${found.kind}`;
  return `template=${encodeURIComponent(name)}${stage}&delta=${offered.delta}`;
}

/** Return the threshold of a template: that of its class where it has its own. */
export function thresholdOf(name: string, offered: TakeTemplates): number {
  return offered.tau_by_class[name] ?? offered.tau;
}

export function useCurves(
  id: number,
  version: number,
  names: readonly string[],
  offered: TakeTemplates | undefined,
  limbs: readonly ErrorLimb[],
): { curves: CurveRow[]; faults: unknown[] } {
  const wanted = offered === undefined ? [] : names.map((name) => `/curve?${about(name, offered)}`);
  const results = useQueries({
    queries: [...wanted, ...limbs.map(({ limb }) => `/limb-error?limb=${encodeURIComponent(limb)}`)].map((question) => ({
      queryKey: ["version", "curve", id, version, question],
      queryFn: async ({ signal }: { signal: AbortSignal }) => new Float32Array(await getBytes(path(id, question), signal)),
    })),
    combine: (found) => ({ data: found.map((one) => one.data), faults: found.map((one) => one.error).filter(Boolean) }),
  });
  const curves = useMemo(() => {
    const rows: CurveRow[] = [];
    results.data.forEach((values, i) => {
      if (values === undefined || offered === undefined) return;
      const name = names[i];
      const limb = limbs[i - wanted.length];
      if (i < wanted.length && name !== undefined) rows.push(templateRow(name, values, thresholdOf(name, offered)));
      else if (limb !== undefined) rows.push(limbRow(limb, values));
    });
    return rows;
    // the names of the questions change with what they are made of
  }, [results.data, offered, names, limbs, wanted.length]);
  return { curves, faults: results.faults };
}

function templateRow(name: string, values: Float32Array, threshold: number): CurveRow {
  const title = `${name}: cost of the best match that ends in a frame; matches below τ = ${threshold} count`;
  return { kind: "curve", id: `curve/${name}`, name, title, values, threshold, top: topOf(values, threshold, 0.5), unit: "", above: false };
}

function limbRow({ limb, tau_deg }: ErrorLimb, values: Float32Array): CurveRow {
  const threshold = tau_deg ?? 45;
  const title = `${limb}: angle between take and sensor; above ${threshold}° the limb is wrong`;
  const name = `${limb} error`;
  return { kind: "curve", id: `limb/${limb}`, name, title, values, threshold, top: 180, unit: "°", above: true };
}

/** Return the value at the upper edge of a curve, as the reports choose it. */
function topOf(values: Float32Array, threshold: number, most: number): number {
  let highest = 0;
  for (const value of values) if (value < Infinity && value > highest) highest = value;
  return Math.max(Math.min(highest, most), 1.5 * threshold, 0.05);
}

export function useHit(id: number, version: number, name: string | null, frame: number, offered?: TakeTemplates) {
  return useQuery({
    queryKey: ["version", "hit", id, version, name, frame],
    queryFn: ({ signal }) => {
      const question = offered === undefined || name === null ? "" : about(name, offered);
      const tau = offered === undefined || name === null ? 0.1 : thresholdOf(name, offered);
      return get<FittedHit>(path(id, `/hit?${question}&frame=${frame}&tau=${tau}`), signal);
    },
    enabled: name !== null && offered !== undefined,
  });
}

export function useImage(name: string | null, version: number, offered?: TakeTemplates) {
  return useQuery({
    queryKey: ["version", "template", name, version],
    queryFn: ({ signal }) =>
      get<TemplateImage>(`/api/template?${offered === undefined ? "" : about(name ?? "", offered)}`, signal),
    enabled: name !== null && offered !== undefined,
  });
}
