// The name of a class, completed from the classes of the store.

import { Autocomplete } from "@mantine/core";
import { forwardRef } from "react";

import { useClassNames } from "./load";

interface ClassInputProps {
  label: string;
  value: string;
  onChange: (value: string) => void;
  /** Enter was pressed, or a class was chosen from the list. */
  onDone?: (value: string) => void;
}

export const ClassInput = forwardRef<HTMLInputElement, ClassInputProps>(function ClassInput(
  { label, value, onChange, onDone },
  ref,
) {
  const names = useClassNames();
  return (
    <Autocomplete
      ref={ref}
      size="xs"
      label={label}
      placeholder="name of a class"
      data={names}
      value={value}
      limit={30}
      maxLength={200}
      onChange={onChange}
      onOptionSubmit={(name) => onDone?.(name)}
      onKeyDown={(event) => {
        if (event.key === "Enter" && value.trim() !== "") onDone?.(value.trim());
        if (event.key === "Escape") event.currentTarget.blur();
      }}
    />
  );
});
