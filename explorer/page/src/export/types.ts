// Requests for an export, and what the server answers.

import type { Job, Same } from "../api/types";

export interface Facts {
  forms: { name: string; meaning: string }[];
  job: Job | null;
}

export interface PlanRow {
  split: string;
  class: string | null;
  clips: number;
  seconds: number;
  bytes: number | null;
}

export interface Plan extends Same {
  clips: number;
  takes: number;
  files: number;
  seconds: number;
  bytes: number | null;
  estimate: string;
  splits: Record<string, { clips: number; seconds: number; share: number }>;
  rows: PlanRow[];
  remarks: string[];
  earlier: boolean;
  /** The state of the store; what is written is refused once it has changed. */
  state: string;
  version: number;
}

export interface Written extends Same {
  folder: string;
  files: number;
  bytes: number;
  excluded: number;
}

/** Return a number of bytes for people. */
export function bytesText(bytes: number | null): string {
  if (bytes === null) return "unknown";
  const units = ["bytes", "kB", "MB", "GB", "TB"];
  let place = 0;
  let value = bytes;
  while (value >= 1000 && place < units.length - 1) {
    value /= 1000;
    place += 1;
  }
  return `${place === 0 ? value : value.toPrecision(3)} ${units[place]}`;
}
