import { Loader, Select, Switch } from "@mantine/core";
import { useCallback, useMemo } from "react";

import { useStore } from "../api/queries";
import type { Selection, Sort } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useArrivals } from "../table/blocks";
import { GroupBy } from "./GroupBy";
import { filterOf, groupsOf, sortsOf, useGroupColumn } from "./groups";
import { useGroups, useTakes } from "./questions";
import { useSelection, useSort } from "./selection";
import { counted, hours } from "./text";
import { isWallSize, WALL_SIZES, WallGrid } from "./WallGrid";

/** The takes of a selection as small moving figures, in groups. */
export function WallView({ selection }: { selection: Selection }) {
  const facts = useStore().data;
  const state = useSelection();
  const [by, setBy] = useGroupColumn("class");
  const [sized, setSized] = useParameter("size");
  const [still, setStill] = useParameter("still");
  const [sort] = useSort();
  const sorts = useMemo<Sort[]>(() => sortsOf(by, sort), [by, sort]);
  const shown = useMemo(() => ["name", "frames", "seconds"], []);
  const takes = useTakes(selection, sorts, shown);
  useArrivals(takes.rows);
  const found = useGroups(selection, by);
  useSame(takes.head);
  const groups = useMemo(() => groupsOf(found.data, takes.head, by), [found.data, takes.head, by]);
  const keep = useCallback(
    (place: number) => {
      const filter = filterOf(by, groups?.[place]);
      if (filter !== null) state.put(filter.column, filter);
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
        <GroupBy by={by} onChange={setBy} />
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
