// Links that take the filters of takes to another page.

import { Button } from "@mantine/core";
import { Link } from "wouter";

import type { useSelection } from "./selection";

interface Props {
  state: ReturnType<typeof useSelection>;
  /** Path, and what the link says. */
  to: readonly (readonly [path: string, text: string])[];
}

/** Return the address of a page for the takes that fit some filters. */
export function addressOfTakes(path: string, { filters, where }: Pick<Props["state"], "filters" | "where">): string {
  const parameters = new URLSearchParams();
  if (filters.length > 0) parameters.set("filters", JSON.stringify(filters));
  if (where !== null) parameters.set("where", where);
  const text = parameters.toString();
  return text === "" ? path : `${path}?${text}`;
}

/** Links to other pages for the takes that fit the filters; without a filter there are none. */
export function HandOn({ state, to }: Props) {
  if (state.filters.length === 0 && state.where === null) return null;
  return to.map(([path, text]) => (
    <Button key={path} component={Link} href={addressOfTakes(path, state)} size="compact-sm" variant="default">
      {text}
    </Button>
  ));
}
