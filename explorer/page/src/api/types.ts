// What the server answers. Each subject adds its own types in its folder; these are shared.

export interface Same {
  command?: string;
  python?: string;
}

export interface Feature {
  bit: number;
  name: string;
  group: string;
  description: string;
}

export interface Column {
  name: string;
  type: string;
  numeric: boolean;
}

export interface StoreFacts extends Same {
  name: string;
  path: string;
  version: number;
  takes: number;
  hours: number;
  rate_hz: number;
  read_only: boolean;
  joints: string[];
  parents: number[];
  features: Feature[];
  columns: Column[];
  classes: string[];
  stages: { annotate: string[]; learn: string[] };
}

export type Value = string | number | boolean | null | Value[] | { [name: string]: Value };

export interface Filter {
  column: string;
  values?: (string | number | boolean | null)[];
  min?: number;
  max?: number;
  contains?: string;
  /** Ids as bits in base64url: a choice of takes on the map. */
  chosen?: string;
}

export interface Sort {
  column: string;
  descending?: boolean;
}

export interface Selection {
  where?: string;
  filters?: Filter[];
}

export interface TakesQuestion extends Selection {
  sort?: Sort[];
  columns?: string[];
  offset?: number;
  limit?: number;
}

export interface TakesBlock extends Same {
  version: number;
  total: number;
  hours: number;
  offset: number;
  columns: string[];
  rows: Value[][];
  ids: number[];
  names: string[];
  warnings: string[][];
}

export interface Job extends Same {
  id: string;
  title: string;
  state: "waiting" | "running" | "done" | "failed" | "stopped";
  stopping: boolean;
  /** How much of it is done, from 0 to 1; null while nobody knows. */
  share: number | null;
  done: number;
  total: number;
  message: string;
  begun: string | null;
  finished: string | null;
  problem: string | null;
}
