// Takes in groups by a column, as wall and table show them: the order of the takes, and the groups in this order.

import type { Filter, Sort } from "../api/types";
import { useStore } from "../api/queries";
import { useParameter } from "../app/address";
import type { useGroups } from "./questions";
import { filterColumns } from "./selection";
import type { WallGroup } from "./wall";

/** The value of the parameter for no groups. */
export const NOTHING = "-";

/** Return the column that takes are grouped by, null for none, and a function that sets it; `absent` where none is chosen. */
export function useGroupColumn(absent: string | null): [string | null, (column: string | null) => void] {
  const [asked, setAsked] = useParameter("group");
  const facts = useStore().data;
  const known = asked !== null && filterColumns(facts).some((one) => one.name === asked);
  const by = asked === NOTHING ? null : known ? asked : absent;
  return [by, (column) => setAsked(column ?? NOTHING, true)];
}

/** Return the order of takes that are grouped by a column: within the groups the one that is asked for. */
export function sortsOf(by: string | null, sort: Sort | null): Sort[] {
  const first = by === null ? [] : [{ column: by, descending: false }];
  return sort === null || sort.column === by ? first : [...first, sort];
}

/** Return the groups in the order of the takes; a last one holds the takes of groups that the answer does not list. */
export function groupsOf(
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

/** Return the filter that shows a group alone, null where the group is that of all further values. */
export function filterOf(by: string | null, group: WallGroup | undefined): Filter | null {
  const value = group?.value;
  if (by === null || value === undefined) return null;
  return value === null || typeof value !== "object" ? { column: by, values: [value] } : null;
}
