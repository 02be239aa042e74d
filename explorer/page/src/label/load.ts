// What the Label page asks the server for.

import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useMemo } from "react";

import { get, post } from "../api/client";
import type { Same } from "../api/types";
import { useStore } from "../api/queries";
import type { Annotation, LabelRow } from "./edits";

export interface LabelFacts extends Same {
  labels: number;
  decisions: number;
  classes: { name: string; positive: number; negative: number }[];
  annotator: string;
  annotators: string[];
  takes: number;
  learned: { stage: string | null; finished: string | null; since: number };
}

export interface TakeLabels extends Same {
  take_id: number;
  take: string;
  frames: number;
  rate_hz: number;
  version: number;
  rows: LabelRow[];
  stage: string | null;
  annotations: Annotation[];
}

export interface QueueRow extends Annotation {
  take: string;
  take_id: number | null;
  verdict: string | null;
  label: string | null;
  nearest: { take_id: number; take: string; start: number; stop: number } | null;
}

export interface QueueBlock extends Same {
  stage: string | null;
  total: number;
  open: number;
  accepted: number;
  rejected: number;
  offset: number;
  rows: QueueRow[];
}

export interface QueueFilter {
  classes: string[];
  takes: string[];
  where: string | null;
  stage: string | null;
}

export function useLabelFacts() {
  return useQuery({
    queryKey: ["labels", "facts", useStore().data?.version],
    queryFn: ({ signal }) => get<LabelFacts>("/api/labels", signal),
    placeholderData: keepPreviousData,
  });
}

/** Return the names of the classes of the store, for completion. */
export function useClassNames(): string[] {
  const facts = useLabelFacts().data;
  return useMemo(() => facts?.classes.map((one) => one.name) ?? [], [facts]);
}

export function useTakeLabels(id: number, take: string, version: number) {
  return useQuery({
    queryKey: ["labels", "of-take", take, version],
    queryFn: ({ signal }) => get<TakeLabels>(`/api/takes/${id}/labels`, signal),
    placeholderData: keepPreviousData,
  });
}

export const QUEUE_BLOCK = 40;

export function askQueue(filter: QueueFilter, offset: number, signal?: AbortSignal): Promise<QueueBlock> {
  return post<QueueBlock>("/api/labels/queue", { ...filter, offset, limit: QUEUE_BLOCK }, signal);
}

/** A label that another label would fit better, with what that is. */
export interface Suspect {
  take_id: number;
  take: string;
  class: string;
  start: number;
  stop: number;
  suspicion: number;
  probability: number;
  kind: "class" | "side" | "edges" | "rate";
  proposal: string;
  new_class: string | null;
  new_start: number | null;
  new_stop: number | null;
  rate_factor: number | null;
  source: string;
  id: string | null;
}

export interface SuspectBlock extends Same {
  judged: number;
  total: number;
  remarks: string[];
  offset: number;
  rows: Suspect[];
}

export function useSuspects(classes: string[], labels: number | undefined) {
  return useQuery({
    queryKey: ["labels", "suspects", classes, useStore().data?.version, labels],
    queryFn: ({ signal }) => post<SuspectBlock>("/api/labels/suspects", { classes, limit: QUEUE_BLOCK }, signal),
    placeholderData: keepPreviousData,
  });
}
