// The rows of a statement of SQL as a table, loaded while they are in sight.

import { useQueryClient } from "@tanstack/react-query";
import { useMemo } from "react";

import { post } from "../api/client";
import type { Value } from "../api/types";
import { Blocks } from "../table/blocks";
import type { GridColumn } from "../table/lines";
import { VirtualGrid } from "../table/VirtualGrid";
import type { SqlAnswer } from "./types";

const BLOCK = 200;

/** Return the question for a block of rows; each turn runs the statement anew. */
export function sqlBlock(text: string, turn: number, block: number) {
  return {
    queryKey: ["version", "sql", text, turn, block],
    queryFn: ({ signal }: { signal: AbortSignal }) =>
      post<SqlAnswer>("/api/ask/sql", { text, offset: block * BLOCK, limit: BLOCK }, signal),
  };
}

const rowsOf = (block: SqlAnswer): Value[][] => block.rows;

export function SqlRows({ first, text, turn }: { first: SqlAnswer; text: string; turn: number }) {
  const client = useQueryClient();
  const rows = useMemo(
    () => new Blocks(client, first.kept, BLOCK, (block) => sqlBlock(text, turn, block), rowsOf),
    [client, first.kept, text, turn],
  );
  const columns = useMemo(() => columnsOf(first), [first]);
  return (
    <div className="sql-rows">
      <VirtualGrid<Value[]> label="Rows" columns={columns} rows={rows} />
    </div>
  );
}

/** Return the columns, as wide as the longest of their first values. */
function columnsOf({ columns, rows }: SqlAnswer): GridColumn<Value[]>[] {
  const some = rows.slice(0, 40);
  return columns.map(({ name, type }, place) => {
    const longest = Math.max(1.15 * name.length, ...some.map((one) => shownValue(one[place]).length));
    return {
      key: String(place),
      title: name,
      about: type,
      width: Math.min(360, Math.max(60, Math.round(8 * longest) + 16)),
      numeric: some.some((one) => typeof one[place] === "number"),
      cell: (row) => shownValue(row[place]),
    };
  });
}

function shownValue(value: Value | undefined): string {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(8)));
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}
