import { Button, Checkbox, Group, Loader, NumberInput, ScrollArea, Stack, Text, TextInput } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { useState } from "react";

import type { Column, Filter, Selection } from "../api/types";
import { Fault } from "../app/Fault";
import { useValues } from "./questions";
import { count, counted, named, shown } from "./text";
import type { ColumnValues } from "./types";

interface Props {
  column: Column;
  filter: Filter | undefined;
  /** The other conditions: counts are those of the takes that fit them. */
  selection: Selection;
  onChange: (filter: Filter | null) => void;
}

/** The editor of a filter: values with their counts, and for numbers a range over their histogram. */
export function FilterEditor({ column, filter, selection, onChange }: Props) {
  const [contains, setContains] = useState("");
  const [searched] = useDebouncedValue(contains, 200);
  const others = {
    ...selection,
    filters: (selection.filters ?? []).filter((one) => one.column !== column.name),
  };
  const found = useValues(others, column.name, searched.trim());
  if (found.isError) return <Fault fault={found.error} />;
  if (found.data === undefined) return <Loader size="sm" aria-label="Loading values" />;
  if (column.numeric) return <RangeEditor values={found.data} filter={filter} column={column.name} onChange={onChange} />;
  return (
    <Stack gap="xs">
      <TextInput
        size="xs"
        label={`Find a value of ${column.name}`}
        value={contains}
        onChange={(event) => setContains(event.currentTarget.value)}
        onKeyDown={(event) => {
          if (event.key === "Enter" && contains.trim() !== "") onChange({ column: column.name, contains: contains.trim() });
        }}
        data-autofocus
      />
      {contains.trim() !== "" && (
        <Button
          size="compact-xs"
          variant="light"
          onClick={() => onChange({ column: column.name, contains: contains.trim() })}
        >
          All that contain “{contains.trim()}”
        </Button>
      )}
      <ValueList values={found.data} filter={filter} column={column.name} onChange={onChange} searched={searched} />
    </Stack>
  );
}

interface ListProps {
  values: ColumnValues;
  column: string;
  filter: Filter | undefined;
  onChange: (filter: Filter | null) => void;
  searched: string;
}

function ValueList({ values, column, filter, onChange, searched }: ListProps) {
  const chosen = filter?.values ?? [];
  const rows: { value: string | number | boolean | null; takes: number }[] = [...values.values];
  if (values.empty > 0 && searched === "") rows.push({ value: null, takes: values.empty });
  const toggle = (value: string | number | boolean | null) => {
    const next = chosen.includes(value) ? chosen.filter((one) => one !== value) : [...chosen, value];
    onChange(next.length === 0 ? null : { column, values: next });
  };
  return (
    <>
      <ScrollArea.Autosize mah={280} type="auto" role="group" aria-label={`Values of ${column}`}>
        <Stack gap={3} pr="sm">
          {rows.map((one) => (
            <Checkbox
              key={JSON.stringify(one.value)}
              size="xs"
              checked={chosen.includes(one.value)}
              onChange={() => toggle(one.value)}
              label={
                <span className="value-count">
                  <span className={one.value === null ? "muted" : ""}>{named(one.value)}</span>
                  <span className="muted number">{count(one.takes)}</span>
                </span>
              }
              classNames={{ labelWrapper: "value-label" }}
            />
          ))}
        </Stack>
      </ScrollArea.Autosize>
      <Text size="xs" className="muted">
        {values.distinct > values.values.length
          ? `the ${count(values.values.length)} most frequent of ${counted(values.distinct, "value")}; find others above`
          : counted(values.distinct, "value")}
      </Text>
    </>
  );
}

function RangeEditor({ values, column, filter, onChange }: Omit<ListProps, "searched">) {
  const bins = values.bins ?? [];
  const most = Math.max(1, ...bins.map((bin) => bin.takes));
  const put = (change: { min?: number | undefined; max?: number | undefined }) => {
    const { min, max } = { min: filter?.min, max: filter?.max, ...change };
    if (min === undefined && max === undefined) onChange(null);
    else onChange({ column, ...(min === undefined ? {} : { min }), ...(max === undefined ? {} : { max }) });
  };
  return (
    <Stack gap="xs">
      {bins.length > 0 && (
        <div className="histogram" aria-hidden>
          {bins.map((bin) => (
            <button
              key={bin.from}
              type="button"
              tabIndex={-1}
              title={`${shown(bin.from)} to ${shown(bin.to)}: ${counted(bin.takes, "take")}`}
              data-inside={bin.to >= (filter?.min ?? -Infinity) && bin.from <= (filter?.max ?? Infinity)}
              onClick={() => put({ min: bin.from, max: bin.to })}
            >
              <span style={{ height: `${Math.max(bin.takes > 0 ? 4 : 0, (100 * bin.takes) / most)}%` }} />
            </button>
          ))}
        </div>
      )}
      <Group gap="xs" grow>
        <NumberInput
          size="xs"
          label="At least"
          placeholder={shown(values.min ?? null)}
          value={filter?.min ?? ""}
          onChange={(value) => put({ min: typeof value === "number" ? value : undefined })}
          data-autofocus
        />
        <NumberInput
          size="xs"
          label="At most"
          placeholder={shown(values.max ?? null)}
          value={filter?.max ?? ""}
          onChange={(value) => put({ max: typeof value === "number" ? value : undefined })}
        />
      </Group>
      {values.empty > 0 && (
        <Text size="xs" className="muted">
          {counted(values.empty, "take")} without a value
        </Text>
      )}
    </Stack>
  );
}
