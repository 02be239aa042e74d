import "./archive.css";

import { Button, CloseButton, Popover, Select, Stack, TextInput } from "@mantine/core";
import { type KeyboardEvent, useEffect, useRef, useState } from "react";

import { useStore } from "../api/queries";
import type { Column, Filter } from "../api/types";
import { useShortcuts } from "../app/shortcuts";
import { FilterEditor } from "./FilterEditor";
import { HandOn } from "./HandOn";
import { filterColumns, type useSelection } from "./selection";
import { filterText } from "./text";

interface Props {
  state: ReturnType<typeof useSelection>;
  /** Why the server refuses the condition of SQL, if it does. */
  fault: string | null;
  /** The pages that the filters can be taken to. */
  to?: readonly (readonly [path: string, text: string])[];
  /** The page, as the list of keys names it. */
  page?: string;
}

const ON: NonNullable<Props["to"]> = [
  ["/ask", "Search these"],
  ["/export", "Export these"],
];

/** Filters as chips, and a condition of SQL. */
export function FilterBar({ state, fault, to = ON, page = "Archive" }: Props) {
  const { filters, put, where, clear } = state;
  const store = useStore();
  const columns = filterColumns(store.data);
  const [adding, setAdding] = useState(false);
  const [column, setColumn] = useState<string | null>(null);
  const chosen = columns.find((one) => one.name === column);
  const sql = useRef<HTMLInputElement>(null);
  useShortcuts(page, [
    { keys: "f", what: "Add a filter", run: () => setAdding(true) },
    { keys: "/", what: "Write a condition of SQL", run: () => sql.current?.focus() },
    { keys: "x", what: "Remove all filters", run: clear },
  ]);
  return (
    <div className="filters" role="search" aria-label="Filters of takes">
      {filters.map((filter) => (
        <Chip
          key={filter.column}
          filter={filter}
          column={columns.find((one) => one.name === filter.column)}
          state={state}
        />
      ))}
      <Popover
        opened={adding}
        onChange={setAdding}
        onClose={() => setColumn(null)}
        position="bottom-start"
        width={320}
        trapFocus
        returnFocus
        shadow="md"
      >
        <Popover.Target>
          <Button size="compact-sm" variant="default" onClick={() => setAdding((shown) => !shown)}>
            Add filter
          </Button>
        </Popover.Target>
        <Popover.Dropdown>
          <Stack gap="xs">
            <Select
              size="xs"
              label="Column"
              placeholder="class, actor, seconds …"
              searchable
              data={columns.map((one) => one.name)}
              value={column}
              onChange={setColumn}
              comboboxProps={{ withinPortal: false }}
              maxDropdownHeight={260}
            />
            {chosen !== undefined && (
              <FilterEditor
                column={chosen}
                filter={filters.find((one) => one.column === chosen.name)}
                selection={state.selection}
                onChange={(filter) => put(chosen.name, filter)}
              />
            )}
          </Stack>
        </Popover.Dropdown>
      </Popover>
      <SqlCondition input={sql} where={where} onChange={state.setWhere} fault={fault} />
      <HandOn state={state} to={to} />
      {(filters.length > 0 || where !== null) && (
        <Button size="compact-sm" variant="subtle" onClick={clear}>
          Clear
        </Button>
      )}
    </div>
  );
}

interface ChipProps {
  filter: Filter;
  column: Column | undefined;
  state: Props["state"];
}

function Chip({ filter, column, state }: ChipProps) {
  const [opened, setOpened] = useState(false);
  const text = filterText(filter);
  return (
    <span className="chip">
      <Popover opened={opened} onChange={setOpened} position="bottom-start" width={320} trapFocus returnFocus shadow="md">
        <Popover.Target>
          <button type="button" className="chip-text" title={`Change the filter ${text}`} onClick={() => setOpened(!opened)}>
            {text}
          </button>
        </Popover.Target>
        <Popover.Dropdown>
          {filter.chosen !== undefined && "These takes were chosen on the map; to change the choice, choose others there."}
          {column !== undefined && (
            <FilterEditor
              column={column}
              filter={filter}
              selection={state.selection}
              onChange={(next) => state.put(filter.column, next)}
            />
          )}
        </Popover.Dropdown>
      </Popover>
      <CloseButton size="xs" aria-label={`Remove the filter ${text}`} onClick={() => state.put(filter.column, null)} />
    </span>
  );
}

interface SqlProps {
  input: React.RefObject<HTMLInputElement | null>;
  where: string | null;
  onChange: (where: string | null, push?: boolean) => void;
  fault: string | null;
}

/** The condition of SQL, which holds once Enter is pressed or the field is left. */
function SqlCondition({ input, where, onChange, fault }: SqlProps) {
  const [text, setText] = useState(where ?? "");
  useEffect(() => setText(where ?? ""), [where]);
  const apply = () => {
    const next = text.trim();
    if (next !== (where ?? "")) onChange(next === "" ? null : next, true);
  };
  const onKey = (event: KeyboardEvent) => {
    if (event.key === "Enter") apply();
    if (event.key === "Escape") {
      setText(where ?? "");
      input.current?.blur();
    }
  };
  return (
    <TextInput
      ref={input}
      className="sql"
      size="xs"
      aria-label="Condition of SQL over takes"
      placeholder="SQL: seconds > 3 AND actor IN ('al', 'bo')"
      leftSection={<span className="muted">WHERE</span>}
      leftSectionWidth={58}
      value={text}
      onChange={(event) => setText(event.currentTarget.value)}
      onKeyDown={onKey}
      onBlur={apply}
      error={fault === null ? undefined : <span className="sql-fault">{fault}</span>}
      spellCheck={false}
      autoComplete="off"
    />
  );
}
