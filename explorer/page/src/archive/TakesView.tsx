import { Button, Checkbox, Popover, ScrollArea, Stack } from "@mantine/core";
import { useMemo } from "react";
import { useLocation } from "wouter";

import { useStore } from "../api/queries";
import type { Column, Selection } from "../api/types";
import { takeAddress } from "../app/address";
import { Fault } from "../app/Fault";
import { type Cell, listed, type RowSource } from "../table/blocks";
import { Grouped } from "../table/grouped";
import type { GridColumn } from "../table/lines";
import { VirtualGrid } from "../table/VirtualGrid";
import { filterOf, groupsOf } from "./groups";
import { type TakeRow, useFlags, useGroups, type useTakes } from "./questions";
import { allColumns, useColumns, type useSelection, useSort } from "./selection";
import { counted, hours, named, shown } from "./text";
import { TotalsPanel } from "./TotalsPanel";
import type { WallGroup } from "./wall";

interface Props {
  state: ReturnType<typeof useSelection>;
  takes: ReturnType<typeof useTakes>;
  columns: string[];
  /** The column that takes are grouped by, if they are. */
  by: string | null;
}

/** The rows where the condition is wrong: others would stay "…" for ever. */
const NOTHING = listed<TakeRow>([]);

/** The table of takes, and their totals beside it. */
export function TakesView({ state, takes, columns, by }: Props) {
  const store = useStore();
  const [sort, toggleSort] = useSort();
  const [, navigate] = useLocation();
  const flags = useFlags().data?.flags;
  const known = useMemo(() => allColumns(store.data), [store.data]);
  const shownColumns = useMemo(() => gridColumns(columns, known, flags), [columns, known, flags]);
  const groups = useGroupsOf(state.selection, takes.head, by);
  const wrong = takes.error !== null;
  const rows = useMemo(() => (wrong ? NOTHING : inGroups(takes.rows, groups)), [wrong, takes.rows, groups]);
  const onHeading = (index: number) => {
    const filter = rows instanceof Grouped ? filterOf(by, groups?.[rows.groupAt(index)]) : null;
    if (filter !== null) state.put(filter.column, filter);
  };
  if (takes.error !== null && state.where === null) return <Fault fault={takes.error} />;
  return (
    <div className="takes">
      <VirtualGrid<TakeRow>
        label="Takes"
        columns={shownColumns}
        rows={rows}
        sort={sort === null ? null : { column: sort.column, descending: sort.descending === true }}
        onSort={toggleSort}
        onOpen={(row) => navigate(takeAddress(row.name))}
        onHeading={onHeading}
      />
      <TotalsPanel state={state} wrong={wrong} />
    </div>
  );
}

function useGroupsOf(selection: Selection, head: ReturnType<typeof useTakes>["head"], by: string | null) {
  const found = useGroups(selection, by).data;
  return useMemo(() => (by === null ? undefined : groupsOf(found, head, by)), [found, head, by]);
}

/** Return rows below the headings of their groups; without, while the groups are those of other filters. */
function inGroups(rows: RowSource<TakeRow>, groups: readonly WallGroup[] | undefined): RowSource<TakeRow> {
  if (groups === undefined || groups.reduce((sum, one) => sum + one.takes, 0) !== rows.count) return rows;
  return new Grouped(rows, groups.map((one) => ({ rows: one.takes, heading: headingOf(one) })));
}

function headingOf({ value, takes, hours: time }: WallGroup): Cell {
  const name = value === undefined ? "all further groups" : named(value);
  return { text: `${name} · ${counted(takes, "take")}, ${hours(time)}`, note: "Enter, or a double click, shows these takes alone" };
}

/** The button that chooses the columns of the table. */
export function ColumnMenu() {
  const store = useStore();
  const [columns, setColumns] = useColumns(store.data);
  return (
    <Popover position="bottom-end" shadow="md" width={250} trapFocus returnFocus>
      <Popover.Target>
        <Button size="compact-sm" variant="default">
          Columns
        </Button>
      </Popover.Target>
      <Popover.Dropdown aria-label="Columns of the table">
        <Checkbox.Group value={columns} onChange={setColumns}>
          <ScrollArea.Autosize mah={380} type="auto">
            <Stack gap={4}>
              {allColumns(store.data)
                .filter((one) => one.name !== "name")
                .map((one) => (
                  <Checkbox key={one.name} size="xs" value={one.name} label={one.name} />
                ))}
            </Stack>
          </ScrollArea.Autosize>
        </Checkbox.Group>
      </Popover.Dropdown>
    </Popover>
  );
}

function gridColumns(
  columns: string[],
  known: Column[],
  flags: Record<string, string[]> | undefined,
): GridColumn<TakeRow>[] {
  const made = columns.map((name, place): GridColumn<TakeRow> => {
    const numeric = known.find((one) => one.name === name)?.numeric ?? false;
    return {
      key: name,
      title: name,
      width: name === "name" ? 250 : numeric ? 88 : name === "class" || name === "actor" ? 120 : 96,
      numeric,
      sortable: true,
      cell: (row) => {
        if (name === "name") return { text: row.name, href: takeAddress(row.name) };
        const value = row.values[place];
        return name === "seconds" && typeof value === "number" ? value.toFixed(2) : shown(value);
      },
    };
  });
  return [...made, { key: "flags", title: "flags", about: FLAGS, width: 70, className: "flag", cell: (row) => flagsOf(row, flags?.[row.id]) }];
}

const FLAGS = "▲ and a number: so many figures of quality beyond their limits, or warnings of ingest. They are listed below the table for the cell that is chosen, and under Quality for all takes.";

function flagsOf(row: TakeRow, texts: string[] = []): Cell {
  const all = [...texts, ...row.warnings];
  return all.length === 0 ? "" : { text: `▲ ${all.length}`, note: all.join("\n") };
}
