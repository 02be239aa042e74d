import { Loader, Select, Text } from "@mantine/core";

import { memo, type MouseEvent, useMemo } from "react";

import { useStore } from "../api/queries";
import type { Filter } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useTotals } from "./questions";
import { filterColumns, type useSelection } from "./selection";
import { count, counted, hours, named } from "./text";
import type { Group } from "./types";

interface PanelProps {
  state: ReturnType<typeof useSelection>;
  /** True if the server refuses the selection. */
  wrong: boolean;
}

/** Hours and takes of the groups by a column; to choose a group filters by it. */
export const TotalsPanel = memo(function TotalsPanel({ state, wrong }: PanelProps) {
  const [by, setBy] = useParameter("by");
  const [second, setSecond] = useParameter("by2");
  const store = useStore();
  const columns = filterColumns(store.data).map((one) => one.name);
  const first = by ?? "class";
  const keys = second === null || second === first ? [first] : [first, second];
  // Groups that a filter of their own column hides stay in sight, to be chosen instead.
  const others = useMemo(
    () => ({ ...state.selection, filters: state.filters.filter((one) => one.column !== first && one.column !== second) }),
    [state.selection, state.filters, first, second],
  );
  const totals = useTotals(others, keys, 500);
  const most = Math.max(1e-9, ...(totals.data?.groups.map((group) => group.hours) ?? []));
  return (
    <section className="totals" aria-label="Totals">
      <div className="totals-head">
        <Select
          size="xs"
          label="Totals by"
          data={columns}
          value={first}
          onChange={(value) => setBy(value === "class" ? null : value, true)}
          allowDeselect={false}
          searchable
        />
        <Select
          size="xs"
          label="and by"
          data={[{ value: "", label: "nothing else" }, ...columns.filter((one) => one !== first)]}
          value={second ?? ""}
          onChange={(value) => setSecond(value, true)}
          allowDeselect={false}
          searchable
        />
      </div>
      {totals.isError && !wrong && <Fault fault={totals.error} />}
      {totals.isPending && <Loader size="sm" m="sm" aria-label="Loading totals" />}
      {totals.data !== undefined && !totals.isError && (
        <>
          <Text size="xs" className="muted" px={10} pb={4}>
            {counted(totals.data.total, "group")}
            {totals.data.groups.length < totals.data.total && `, the ${count(totals.data.groups.length)} longest shown`}
          </Text>
          <div className="totals-list">
            <table>
              <thead>
                <tr>
                  <th scope="col">{keys.join(" · ")}</th>
                  <th scope="col" className="number">
                    takes
                  </th>
                  <th scope="col" className="number">
                    time
                  </th>
                </tr>
              </thead>
              <tbody>
                {totals.data.groups.map((group) => (
                  <GroupRow key={JSON.stringify(group.values)} group={group} keys={keys} most={most} state={state} />
                ))}
              </tbody>
            </table>
          </div>
        </>
      )}
    </section>
  );
});

interface RowProps {
  group: Group;
  keys: string[];
  most: number;
  state: ReturnType<typeof useSelection>;
}

function GroupRow({ group, keys, most, state }: RowProps) {
  const filters = keys.map((key) => state.filters.find((one) => one.column === key)?.values);
  const chosen = filters.every((values, place) => values?.includes(group.values[place] ?? null) ?? false);
  /** Filter by this group alone, or take the filter back; with Ctrl or ⌘ among others. */
  const choose = (event: MouseEvent) => {
    const more = keys.length === 1 && (event.ctrlKey || event.metaKey);
    const next = keys.map((key, place): [string, Filter | null] => {
      const value = group.values[place] ?? null;
      const others = more ? (filters[place] ?? []).filter((one) => one !== value) : [];
      const values = chosen && (more || filters[place]?.length === 1) ? others : [...others, value];
      return [key, values.length === 0 ? null : { column: key, values }];
    });
    state.putAll(Object.fromEntries(next));
  };
  const text = group.values.map(named).join(" · ");
  return (
    <tr>
      <th scope="row">
        <button type="button" aria-pressed={chosen} title={text} onClick={choose}>
          <span className={group.values.includes(null) ? "muted" : ""}>{text}</span>
          <span className="bar" style={{ width: `${(100 * group.hours) / most}%` }} />
        </button>
      </th>
      <td className="number">{count(group.takes)}</td>
      <td className="number">{hours(group.hours)}</td>
    </tr>
  );
}
