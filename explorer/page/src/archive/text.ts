// Values as text.

import type { Filter, Value } from "../api/types";
import { unpackedIds } from "./map";

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const three = new Intl.NumberFormat("en", { maximumSignificantDigits: 4 });

export function count(value: number): string {
  return whole.format(value);
}

export function counted(value: number, noun: string): string {
  return `${whole.format(value)} ${noun}${value === 1 ? "" : "s"}`;
}

/** A duration as people read it: 4.45 h, 12.3 min, 8.1 s. */
export function hours(value: number): string {
  if (value >= 1 || value === 0) return `${value.toFixed(2)} h`;
  return value * 60 >= 1 ? `${(value * 60).toFixed(1)} min` : `${(value * 3600).toFixed(1)} s`;
}

export function shown(value: Value | undefined): string {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : three.format(value);
  if (Array.isArray(value)) return value.map(shown).join("; ");
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

/** A message about a file without the path and the line in front, which have columns of their own. */
export function reasonOf(message: string, source: string): string {
  const at = source === "" ? -1 : message.indexOf(source);
  return at < 0 ? message : message.slice(at + source.length).replace(/^(:\d+)?: /, "");
}

/** A value of a filter; none is named. */
export function named(value: Value | undefined): string {
  return value === null || value === undefined ? "none" : value === "" ? "empty text" : shown(value);
}

const SOME = 3;

/** A filter as its chip shows it. */
export function filterText(filter: Filter): string {
  if (filter.chosen !== undefined) return `chosen on the map: ${counted(unpackedIds(filter.chosen).length, "take")}`;
  const parts: string[] = [];
  if (filter.values !== undefined) {
    const more = filter.values.length - SOME;
    const values = filter.values.slice(0, SOME).map(named).join(", ");
    parts.push(filter.values.length === 0 ? "nothing" : more > 0 ? `${values} and ${more} more` : values);
  }
  if (filter.min !== undefined && filter.max !== undefined) parts.push(`${shown(filter.min)} to ${shown(filter.max)}`);
  else if (filter.min !== undefined) parts.push(`at least ${shown(filter.min)}`);
  else if (filter.max !== undefined) parts.push(`at most ${shown(filter.max)}`);
  if (filter.contains !== undefined) parts.push(`contains “${filter.contains}”`);
  return `${filter.column}: ${parts.join(", ")}`;
}
