import { Loader, Select, Switch } from "@mantine/core";
import { useCallback, useMemo } from "react";

import { useStore } from "../api/queries";
import type { Selection, Sort } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useArrivals } from "../table/blocks";
import { useGroups, useTakes } from "./questions";
import { filterColumns, useSelection, useSort } from "./selection";
import { counted, hours } from "./text";
import { isWallSize, WALL_SIZES, WallGrid } from "./WallGrid";
import type { WallGroup } from "./wall";

const NOTHING = "-";

/** The takes of a selection as small moving figures, in groups. */
export function WallView({ selection }: { selection: Selection }) {
  const facts = useStore().data;
  const state = useSelection();
  const [asked, setAsked] = useParameter("group");
  const [sized, setSized] = useParameter("size");
  const [still, setStill] = useParameter("still");
  const [sort] = useSort();
  const columns = filterColumns(facts).map((one) => one.name);
  const by = asked === NOTHING ? null : asked !== null && columns.includes(asked) ? asked : "class";
  const sorts = useMemo<Sort[]>(() => sortsOf(by, sort), [by, sort]);
  const shown = useMemo(() => ["name", "frames", "seconds"], []);
  const takes = useTakes(selection, sorts, shown);
  useArrivals(takes.rows);
  const found = useGroups(selection, by);
  useSame(takes.head);
  const groups = useMemo(() => groupsOf(found.data, takes.head, by), [found.data, takes.head, by]);
  const keep = useCallback(
    (place: number) => {
      const value = groups?.[place]?.value;
      if (by !== null && (value === null || ["string", "number", "boolean"].includes(typeof value)))
        state.put(by, { column: by, values: [value as string | number | boolean | null] });
    },
    [groups, by, state],
  );
  const toggleStill = () => setStill(still === null ? "1" : null);
  const size = isWallSize(sized) ? sized : "medium";
  const fault = takes.error ?? found.error;
  if (fault !== null) return <Fault fault={fault} />;
  return (
    <div className="wall-view">
      <div className="wall-bar">
        <span role="status" aria-live="polite" className="wall-amount">
          {takes.head !== undefined && (
            <>
              <strong>{counted(takes.head.total, "take")}</strong>, {hours(takes.head.hours)}
              {by !== null && found.data !== undefined && <span className="muted"> in {counted(found.data.total, "group")}</span>}
            </>
          )}
        </span>
        <Switch size="xs" label="Motion" checked={still === null} onChange={toggleStill} />
        <Select
          size="xs"
          w={136}
          aria-label="Size of the figures"
          data={WALL_SIZES.map((one) => ({ value: one, label: `${one} figures` }))}
          value={size}
          onChange={(value) => setSized(value === "medium" ? null : value)}
          allowDeselect={false}
        />
        <span className="wall-by">
          <span id="wall-by">Grouped by</span>
          <Select
            size="xs"
            w={150}
            aria-labelledby="wall-by"
            data={[{ value: NOTHING, label: "nothing" }, ...columns]}
            value={by ?? NOTHING}
            onChange={(value) => setAsked(value === "class" ? null : value, true)}
            allowDeselect={false}
            searchable
          />
        </span>
      </div>
      {groups === undefined ? (
        <Loader size="sm" aria-label="Loading" />
      ) : groups.length === 0 ? (
        <p className="muted">No take fits the filters.</p>
      ) : (
        <WallGrid
          groups={groups}
          by={by}
          rateHz={facts?.rate_hz ?? 30}
          size={size}
          still={still !== null}
          row={takes.rows.row}
          onRange={takes.rows.look}
          onKeep={keep}
          onStill={toggleStill}
        />
      )}
    </div>
  );
}

function sortsOf(by: string | null, sort: Sort | null): Sort[] {
  const first = by === null ? [] : [{ column: by, descending: false }];
  return sort === null || sort.column === by ? first : [...first, sort];
}

/** Return the groups in the order of the takes; a last one holds the takes of groups that the answer does not list. */
function groupsOf(
  found: ReturnType<typeof useGroups>["data"],
  head: { total: number; hours: number } | undefined,
  by: string | null,
): WallGroup[] | undefined {
  if (by === null) {
    if (head === undefined) return undefined;
    return head.total === 0 ? [] : [{ value: undefined, takes: head.total, hours: head.hours }];
  }
  if (found === undefined) return undefined;
  const groups = found.groups.map((one): WallGroup => ({ value: one.values[0], takes: one.takes, hours: one.hours }));
  const sum = (what: "takes" | "hours") => groups.reduce((total, one) => total + one[what], 0);
  const rest = { value: undefined, takes: found.takes - sum("takes"), hours: Math.max(0, found.hours - sum("hours")) };
  return rest.takes > 0 ? [...groups, rest] : groups;
}
