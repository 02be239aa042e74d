// Questions of the Archive page to the server.

import { keepPreviousData, useQueries, useQuery } from "@tanstack/react-query";
import { useCallback, useEffect, useMemo, useRef, useState } from "react";

import { get, post } from "../api/client";
import type { Selection, Sort, TakesBlock, TakesQuestion, Value } from "../api/types";
import type { ColumnValues, Flags, Quality, RowsOf, Totals } from "./types";

const BLOCK = 100;
/** Blocks are asked for once the table has been still for so long, so that a long scroll asks for few. */
const STILL_MS = 60;
/** Most groups of one answer. */
const MOST_GROUPS = 2000;

export interface TakeRow {
  id: number;
  name: string;
  values: Value[];
  warnings: string[];
}

/** The takes of a selection: rows in sight, and the totals of all. */
export function useTakes(selection: Selection, sort: readonly Sort[], columns: string[]) {
  const [range, setRange] = useState<[number, number]>([0, 1]);
  const still = useStill(range);
  const [first, stop] = range;
  const question = useMemo<TakesQuestion>(
    () => ({ ...selection, sort: [...sort], columns, limit: BLOCK }),
    [selection, sort, columns],
  );
  const numbers = [0, ...Array.from({ length: stop - first }, (_, place) => first + place).filter((one) => one > 0)];
  const found = useQueries({
    queries: numbers.map((number) => ({
      queryKey: ["version", "takes", question, number],
      queryFn: ({ signal }: { signal: AbortSignal }) =>
        post<TakesBlock>("/api/takes", { ...question, offset: number * BLOCK }, signal),
      enabled: still || number === 0,
    })),
  });
  const head = found[0]?.data;
  const last = useRef<TakesBlock>(undefined);
  if (head !== undefined) last.current = head;
  const blocks = new Map(found.map((one, place) => [numbers[place], one.data] as const));
  const rowsOf = useRowsOf();
  const row = (index: number) => rowsOf(blocks.get(Math.floor(index / BLOCK)))?.[index % BLOCK];
  // Only a change of blocks renders the page anew, not every row that comes into sight.
  const onRange = useCallback((from: number, to: number) => {
    const first = Math.floor(from / BLOCK);
    const stop = Math.max(first + 1, Math.ceil(to / BLOCK));
    setRange((before) => (before[0] === first && before[1] === stop ? before : [first, stop]));
  }, []);
  return { head: head ?? last.current, error: found[0]?.error ?? null, row, onRange, pending: head === undefined };
}

/** Return a function that makes the rows of a block once, so that rows in sight keep their identity. */
function useRowsOf() {
  const made = useRef(new WeakMap<TakesBlock, TakeRow[]>());
  return (block: TakesBlock | undefined): TakeRow[] | undefined => {
    if (block === undefined) return undefined;
    let rows = made.current.get(block);
    if (rows === undefined) {
      rows = block.rows.map((values, place) => ({
        id: block.ids[place] ?? -1,
        name: block.names[place] ?? "",
        values,
        warnings: block.warnings[place] ?? [],
      }));
      made.current.set(block, rows);
    }
    return rows;
  };
}

function useStill(range: [number, number]): boolean {
  const [still, setStill] = useState(range);
  useEffect(() => {
    const timer = setTimeout(() => setStill(range), STILL_MS);
    return () => clearTimeout(timer);
  }, [range]);
  return still === range;
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
      post<Totals>("/api/totals", { ...selection, by: [by], order: "value", limit: MOST_GROUPS }, signal),
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
