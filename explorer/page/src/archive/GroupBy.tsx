import { Select } from "@mantine/core";
import { useId } from "react";

import { useStore } from "../api/queries";
import { NOTHING } from "./groups";
import { filterColumns } from "./selection";

interface Props {
  by: string | null;
  onChange: (column: string | null) => void;
}

/** The column that takes are grouped by. */
export function GroupBy({ by, onChange }: Props) {
  const id = useId();
  const facts = useStore().data;
  return (
    <span className="group-by">
      <span id={id}>Grouped by</span>
      <Select
        size="xs"
        w={150}
        aria-labelledby={id}
        data={[{ value: NOTHING, label: "nothing" }, ...filterColumns(facts).map((one) => one.name)]}
        value={by ?? NOTHING}
        onChange={(value) => onChange(value === NOTHING ? null : value)}
        allowDeselect={false}
        searchable
      />
    </span>
  );
}
