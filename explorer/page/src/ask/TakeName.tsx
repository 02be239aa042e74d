// A field for the name of a take, which lists those that contain what is typed.

import { Autocomplete } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { keepPreviousData, useQuery } from "@tanstack/react-query";

import { post } from "../api/client";
import type { TakesBlock } from "../api/types";

export interface NamedTake {
  id: number;
  frames: number;
  seconds: number;
}

export interface TakeNameProps {
  value: string;
  onChange: (name: string) => void;
  width: number;
}

const WAIT_MS = 200;

export function TakeName({ value, onChange, width }: TakeNameProps) {
  const [typed] = useDebouncedValue(value, WAIT_MS);
  const found = useQuery({
    queryKey: ["version", "take-names", typed],
    queryFn: ({ signal }) =>
      post<TakesBlock>(
        "/api/takes",
        { columns: ["name"], filters: typed === "" ? [] : [{ column: "name", contains: typed }], limit: 30 },
        signal,
      ),
    placeholderData: keepPreviousData,
  });
  return (
    <Autocomplete
      size="xs"
      label="Take"
      w={width}
      data={found.data?.names ?? []}
      filter={({ options }) => options}
      value={value}
      onChange={onChange}
    />
  );
}

/** Return what is known about takes by their names, once the server has answered. */
export function useNamedTakes(names: readonly string[]): Map<string, NamedTake> | undefined {
  const sorted = [...new Set(names)].sort();
  const block = useQuery({
    queryKey: ["version", "named-takes", sorted],
    queryFn: ({ signal }) =>
      post<TakesBlock>(
        "/api/takes",
        { columns: ["frames", "seconds"], filters: [{ column: "name", values: sorted }], limit: 500 },
        signal,
      ),
    enabled: sorted.length > 0,
    select: ({ ids, names: found, rows }) =>
      new Map(
        found.map((name, i): [string, NamedTake] => {
          const [frames, seconds] = rows[i] as [number, number];
          return [name, { id: ids[i] as number, frames, seconds }];
        }),
      ),
  });
  return block.data;
}
