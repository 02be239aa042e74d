// Answers that the Archive page alone reads.

import type { Same, Selection, Value } from "../api/types";

export interface Group {
  values: (string | number | boolean | null)[];
  takes: number;
  hours: number;
}

export interface Totals extends Same {
  groups: Group[];
  total: number;
  takes: number;
  hours: number;
}

export interface TotalsQuestion extends Selection {
  by: string[];
  limit?: number;
}

export interface ColumnValues {
  column: string;
  values: { value: string | number | boolean; takes: number }[];
  distinct: number;
  empty: number;
  min?: number | null;
  max?: number | null;
  bins?: { from: number; to: number; takes: number }[];
}

export interface Quality extends Same {
  figures: {
    figure: string;
    meaning: string;
    unit: string;
    low: number | null;
    high: number | null;
    advice: string;
    takes: number;
  }[];
  warnings: { warning: string; takes: number }[];
  invalid: { takes: number; frames: number };
}

export interface Flags {
  flags: Record<string, string[]>;
  total: number;
}

export interface RowsOf extends Same {
  rows: Record<string, Value>[];
  total: number;
  searched?: boolean;
}
