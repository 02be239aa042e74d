// Questions of the Archive page to the server.

import { keepPreviousData, useQuery, useQueryClient } from "@tanstack/react-query";
import { useMemo, useRef } from "react";

import { get, post } from "../api/client";
import type { Selection, Sort, TakesBlock, TakesQuestion, Value } from "../api/types";
import { Blocks } from "../table/blocks";
import type { ColumnValues, Flags, Quality, RowsOf, Totals } from "./types";

const BLOCK = 100;
/** Most groups of one answer. */
const MAX_GROUPS = 2000;

export interface TakeRow {
  id: number;
  name: string;
  values: Value[];
  warnings: string[];
}

/** The takes of a selection: rows, loaded while they are in sight, and the totals of all. */
export function useTakes(selection: Selection, sort: readonly Sort[], columns: string[]) {
  const client = useQueryClient();
  const query = useMemo(() => {
    const question: TakesQuestion = { ...selection, sort: [...sort], columns, limit: BLOCK };
    return (block: number) => ({
      queryKey: ["version", "takes", question, block],
      queryFn: ({ signal }: { signal: AbortSignal }) =>
        post<TakesBlock>("/api/takes", { ...question, offset: block * BLOCK }, signal),
    });
  }, [selection, sort, columns]);
  const first = useQuery(query(0));
  const last = useRef<TakesBlock>(undefined);
  if (first.data !== undefined) last.current = first.data;
  const head = first.data ?? last.current;
  const count = head?.total ?? 0;
  const rows = useMemo(() => new Blocks(client, count, BLOCK, query, rowsOf), [client, count, query]);
  return { head, error: first.error, rows };
}

function rowsOf(block: TakesBlock): TakeRow[] {
  return block.rows.map((values, place) => ({
    id: block.ids[place] ?? -1,
    name: block.names[place] ?? "",
    values,
    warnings: block.warnings[place] ?? [],
  }));
}

export function useTotals(selection: Selection, by: string[], limit = 200) {
  return useQuery({
    queryKey: ["version", "totals", selection, by, limit],
    queryFn: ({ signal }) => post<Totals>("/api/totals", { ...selection, by, limit }, signal),
    placeholderData: keepPreviousData,
    enabled: by.length > 0,
  });
}

/** The groups of takes by a column, in the order of its values; none are asked for without a column. */
export function useGroups(selection: Selection, by: string | null) {
  return useQuery({
    queryKey: ["version", "groups", selection, by],
    queryFn: ({ signal }) =>
      post<Totals>("/api/totals", { ...selection, by: [by], order: "value", limit: MAX_GROUPS }, signal),
    // Groups of other filters stay until theirs are there, so that the grid keeps the focus; those of another column do not.
    placeholderData: (before, query) => (query?.queryKey[3] === by ? before : undefined),
    enabled: by !== null,
  });
}

export function useValues(selection: Selection, column: string, contains: string) {
  return useQuery({
    queryKey: ["version", "values", selection, column, contains],
    queryFn: ({ signal }) =>
      post<ColumnValues>("/api/values", { ...selection, column, ...(contains === "" ? {} : { contains }) }, signal),
    placeholderData: (before) => (before?.column === column ? before : undefined),
  });
}

export function useFlags() {
  return useQuery({ queryKey: ["version", "flags"], queryFn: ({ signal }) => get<Flags>("/api/flags", signal) });
}

export function useQuality() {
  return useQuery({ queryKey: ["version", "quality"], queryFn: ({ signal }) => get<Quality>("/api/quality", signal) });
}

export function useRows(path: "/api/duplicates" | "/api/excluded") {
  return useQuery({ queryKey: ["version", path], queryFn: ({ signal }) => get<RowsOf>(path, signal) });
}
