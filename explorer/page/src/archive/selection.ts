// What the Archive page shows, in the address: filters, SQL, order, columns and groups.

import { useCallback, useMemo } from "react";

import type { Column, Filter, Selection, Sort, StoreFacts } from "../api/types";
import { useJsonParameter, useParameter, useParameters } from "../app/address";

/** A column that takes do not have: the folder of the source file. */
export const FOLDER: Column = { name: "folder", type: "VARCHAR", numeric: false };

export const SHOWN = ["name", "class", "actor", "seconds", "frames"];

/** Columns that nobody filters by or reads in a table unless asked for. */
const TECHNICAL = new Set(["take_id", "checksum", "recipe", "groups", "known", "source_mtime_ns", "warnings"]);

const NO_FILTERS: Filter[] = [];

export function useSelection() {
  const [filters, setFilters] = useJsonParameter<Filter[]>("filters", NO_FILTERS);
  const [where, setWhere] = useParameter("where");
  const sound = useMemo(() => (Array.isArray(filters) ? filters.filter(isFilter) : NO_FILTERS), [filters]);
  const selection = useMemo<Selection>(
    () => ({ filters: sound, ...(where === null ? {} : { where }) }),
    [sound, where],
  );
  const change = useCallback((next: Filter[]) => setFilters(next.length === 0 ? null : next, true), [setFilters]);
  /** Replace the filters of some columns in one step; null removes one. */
  const putAll = useCallback(
    (columns: Record<string, Filter | null>) => {
      const rest = new Map(Object.entries(columns));
      const next = sound.flatMap((one) => {
        const filter = rest.get(one.column);
        rest.delete(one.column);
        return filter === undefined ? [one] : filter === null ? [] : [filter];
      });
      change([...next, ...[...rest.values()].filter((one) => one !== null)]);
    },
    [sound, change],
  );
  const put = useCallback((column: string, filter: Filter | null) => putAll({ [column]: filter }), [putAll]);
  const clear = useClear();
  return useMemo(
    () => ({ selection, filters: sound, where, setWhere, put, putAll, clear }),
    [selection, sound, where, setWhere, put, putAll, clear],
  );
}

function useClear(): () => void {
  const change = useParameters();
  return useCallback(() => change({ filters: null, where: null }, true), [change]);
}

function isFilter(one: unknown): one is Filter {
  return typeof one === "object" && one !== null && typeof (one as Filter).column === "string";
}

export function useSort(): [Sort | null, (column: string) => void] {
  const [text, set] = useParameter("sort");
  const sort = useMemo(() => {
    if (text === null) return null;
    return text.endsWith("-") ? { column: text.slice(0, -1), descending: true } : { column: text, descending: false };
  }, [text]);
  const toggle = useCallback(
    (column: string) => set(sort?.column !== column ? column : sort.descending === true ? null : `${column}-`, true),
    [set, sort],
  );
  return [sort, toggle];
}

export function useColumns(facts: StoreFacts | undefined): [string[], (columns: string[]) => void] {
  const [text, set] = useParameter("columns");
  const known = useMemo(() => new Set(allColumns(facts).map((one) => one.name)), [facts]);
  const columns = useMemo(() => {
    const asked = text === null ? [...SHOWN, ...ownColumns(facts)] : text.split(",");
    const shown = facts === undefined ? asked : asked.filter((name) => known.has(name));
    return shown.includes("name") ? shown : ["name", ...shown];
  }, [text, known, facts]);
  const change = useCallback((next: string[]) => set(next.join(",")), [set]);
  return [columns, change];
}

export function allColumns(facts: StoreFacts | undefined): Column[] {
  if (facts === undefined) return [];
  return facts.columns.some((one) => one.name === FOLDER.name) ? facts.columns : [...facts.columns, FOLDER];
}

/** Columns that people filter by, first those that most archives have. */
export function filterColumns(facts: StoreFacts | undefined): Column[] {
  const first = ["class", "actor", FOLDER.name, "name", "seconds", "format", ...ownColumns(facts)];
  const rank = (one: Column) => {
    const place = first.indexOf(one.name);
    return place < 0 ? first.length : place;
  };
  return allColumns(facts)
    .filter((one) => !TECHNICAL.has(one.name))
    .sort((a, b) => rank(a) - rank(b));
}

/** The columns that the patterns of this archive's ingest have added: texts after the columns of every store. */
function ownColumns(facts: StoreFacts | undefined): string[] {
  if (facts === undefined) return [];
  const last = facts.columns.findIndex((one) => one.name === "known");
  return facts.columns
    .slice(last + 1)
    .filter((one) => one.type === "VARCHAR" && !["estimated_joints", "up_axis", "left_right"].includes(one.name))
    .map((one) => one.name);
}

/** Return the address of the takes that fit a condition of SQL. */
export function takesWhere(condition: string): string {
  return `/?where=${encodeURIComponent(condition)}`;
}
