import { Code, Loader, Text } from "@mantine/core";
import { useMemo } from "react";
import { Link, useLocation } from "wouter";

import type { Value } from "../api/types";
import { takeAddress } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { listed } from "../table/blocks";
import type { GridColumn } from "../table/lines";
import { VirtualGrid } from "../table/VirtualGrid";
import { useRows } from "./questions";
import { takesWhere } from "./selection";
import { count, counted, reasonOf, shown } from "./text";
import type { RowsOf } from "./types";

type Row = Record<string, Value>;

function text(key: string, title: string, width: number, numeric = false): GridColumn<Row> {
  return { key, title, width, numeric, cell: (row) => shown(row[key]) };
}

function take(key: string, title: string): GridColumn<Row> {
  return {
    key,
    title,
    width: 230,
    cell: (row) => ({ text: shown(row[key]), href: takeAddress(shown(row[key])) }),
  };
}

const DUPLICATES: GridColumn<Row>[] = [
  take("take", "take"),
  take("of_take", "holds the motion of"),
  // rows of earlier versions have no changes
  { key: "changes", title: "copy", width: 200, cell: (row) => shown(row.changes ?? row.same) },
  {
    key: "share",
    title: "share",
    width: 80,
    numeric: true,
    cell: (row) => (typeof row.share === "number" ? `${Math.round(100 * row.share)} %` : ""),
  },
  text("start_seconds", "from s", 90, true),
  text("stop_seconds", "to s", 90, true),
  {
    key: "shift_seconds",
    title: "shift ms",
    width: 90,
    numeric: true,
    cell: (row) => (typeof row.shift_seconds === "number" ? shown(1000 * row.shift_seconds) : ""),
  },
  text("distance_mm", "distance mm", 110, true),
];

const EXCLUDED: GridColumn<Row>[] = [
  text("source", "source file", 130),
  {
    key: "message",
    title: "message",
    width: 640,
    cell: (row) => ({ text: reasonOf(shown(row.message), shown(row.source)), note: shown(row.message) }),
  },
  text("line", "line", 70, true),
  text("error", "error", 120),
];

/** Takes that hold the same file or motion as another take. */
export function DuplicatesView() {
  const [, navigate] = useLocation();
  const found = useRows("/api/duplicates");
  useSame(found.data);
  return (
    <RowsGrid
      found={found}
      label="Duplicates"
      columns={DUPLICATES}
      onOpen={(row) => navigate(takeAddress(shown(row.take)))}
      more={
        <>
          {" "}
          · takes: <Link href={takesWhere("take_id IN (SELECT take_id FROM duplicates)")}>those listed</Link>,{" "}
          <Link href={takesWhere("take_id NOT IN (SELECT take_id FROM duplicates WHERE share > 0.9)")}>
            those that repeat no other
          </Link>
        </>
      }
      none={
        found.data?.searched === true ? (
          "No two takes hold the same motion."
        ) : (
          <>
            Nobody has looked for duplicates yet. <Code>{found.data?.command}</Code> finds copies of files and of motions,
            also trimmed, resampled, moved, mirrored or noisy ones and those of another body; this page shows them as soon as it is done.
          </>
        )
      }
    />
  );
}

/** Source files that the last ingest excluded, with the reasons. */
export function ExcludedView() {
  const found = useRows("/api/excluded");
  useSame(found.data);
  return (
    <RowsGrid found={found} label="Excluded files" columns={EXCLUDED} none="The last ingest has read all source files." />
  );
}

interface Props {
  found: ReturnType<typeof useRows>;
  label: string;
  columns: GridColumn<Row>[];
  none: React.ReactNode;
  onOpen?: (row: Row) => void;
  /** What follows the number of rows. */
  more?: React.ReactNode;
}

function RowsGrid({ found, label, columns, none, onOpen, more }: Props) {
  const rows = useMemo(() => listed<Row>(found.data?.rows ?? []), [found.data]);
  if (found.isError) return <Fault fault={found.error} />;
  if (found.data === undefined) return <Loader size="sm" aria-label="Loading" />;
  const data: RowsOf = found.data;
  if (data.rows.length === 0)
    return (
      <Text size="sm" className="sheet">
        {none}
      </Text>
    );
  return (
    <div className="rows">
      <Text size="xs" className="muted" pb={4} role="status">
        {counted(data.total, "row")}
        {data.rows.length < data.total && `, the first ${count(data.rows.length)} shown; the command below lists all`}
        {more}
      </Text>
      <div className="rows-grid">
        <VirtualGrid<Row>
          label={label}
          columns={columns}
          rows={rows}
          {...(onOpen === undefined ? {} : { onOpen })}
        />
      </div>
    </div>
  );
}
