// Files and addresses that hits leave the page as.

import type { Interval } from "./types";

/** Most hits that an address holds; servers refuse longer addresses. */
const MAX_HITS = 200;

/** Return the address of Export with intervals; beyond what an address holds, it asks for the file of intervals. */
export function exportAddress(intervals: readonly Interval[], label: string): string {
  if (intervals.length === 0) return label === "" ? "/export" : `/export?what=labels&classes=${encodeURIComponent(JSON.stringify([label]))}`;
  if (intervals.length > MAX_HITS) return "/export?what=ranges";
  const hits = intervals.map(({ take, start, stop, mirrored }) => ({
    take,
    start,
    stop,
    ...(label === "" ? {} : { class: label }),
    ...(mirrored ? { mirrored } : {}),
  }));
  return `/export?${new URLSearchParams({ hits: JSON.stringify(hits) }).toString()}`;
}

/** Return intervals as CSV. A text that a spreadsheet would take for a formula gets an apostrophe in front. */
export function rangesOf(intervals: readonly Interval[], label: string): string {
  const cell = (text: string) => {
    const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
    return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  };
  const head = label === "" ? "take,start,stop" : "take,start,stop,class";
  const rows = intervals.map((one) => [cell(one.take), one.start, one.stop, ...(label === "" ? [] : [cell(label)])].join(","));
  return [head, ...rows, ""].join("\n");
}

/** Hand a text to the browser as a file, and return the name of the file. */
export function download(name: string, text: string, type: string): string {
  const safe = name.replaceAll(/[^\p{L}\p{N}._-]/gu, "_");
  const address = URL.createObjectURL(new Blob([text], { type }));
  const link = document.createElement("a");
  link.href = address;
  link.download = safe;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
  return safe;
}
