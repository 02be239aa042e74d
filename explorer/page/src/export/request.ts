// The request in the address: a link opens the same plan.

import { useMemo } from "react";

import { useParameters } from "../app/address";
import { useSearch } from "wouter";

export type Values = Record<string, string>;

export const KEYS = [
  "what", "name", "where", "classes", "pipeline", "confidence", "form", "joints", "split", "shares", "seed", "margin",
  "context", "shortest", "mirror", "balance", "perclass", "distinct", "rate", "inplace", "folder", "hits", "filters",
] as const;

/** Return the values of the address, and a function that sets some of them. */
export function useRequest(): [Values, (values: Record<string, string | null>) => void] {
  const search = useSearch();
  const values = useMemo(() => {
    const parameters = new URLSearchParams(window.location.search);
    return Object.fromEntries(KEYS.map((key) => [key, parameters.get(key) ?? ""]));
  }, [search]);
  return [values, useParameters()];
}

/** Return the number of a text, null where it is empty; what is no number is sent as it is, and the server refuses it. */
function number(text: string | undefined): number | string | null {
  if (text === undefined || text.trim() === "") return null;
  const found = Number(text);
  return Number.isFinite(found) ? found : text;
}

function metres(text: string | undefined): number | string | null {
  const centimetres = number(text);
  return typeof centimetres === "number" ? centimetres / 100 : centimetres;
}

function json(text: string | undefined): unknown[] {
  try {
    const found: unknown = JSON.parse(text || "[]");
    return Array.isArray(found) ? found : [];
  } catch {
    return [];
  }
}

/** Return the classes of the address. */
export function classesOf(values: Values): string[] {
  return json(values.classes).filter((one): one is string => typeof one === "string");
}

/** Return the body of the request: what is cut out, how, and the folder. */
export function bodyOf(values: Values): Record<string, unknown> {
  const kind = values.what || "takes";
  const what = {
    kind,
    name: ["hits", "ranges", "sql"].includes(kind) ? values.name || null : null,
    where: values.where || null,
    classes: classesOf(values),
    pipeline: kind === "annotations" ? values.pipeline || null : null,
    min_confidence: kind === "annotations" ? number(values.confidence) : null,
  };
  const how = {
    form: values.form || "csv",
    joints: values.joints === "1",
    split: values.split || null,
    shares: (values.shares || "0.8,0.1,0.1").split(",").map(Number),
    seed: number(values.seed) ?? 0,
    margin: number(values.margin) ?? 0,
    context: number(values.context) ?? 0,
    min_length: number(values.shortest) ?? 0,
    mirror: values.mirror === "1",
    balance: values.balance === "1",
    per_class: number(values.perclass),
    distinct: metres(values.distinct),
    rate_hz: number(values.rate),
    in_place: values.inplace === "1",
  };
  return { what, how, hits: json(values.hits), filters: json(values.filters), folder: values.folder || null };
}
