// What the server answers about pipelines and their runs.

import type { Same } from "../api/types";

export interface Setting {
  name: string;
  default: string | null;
  last: string | null;
}

export interface Pipeline {
  id: string;
  name: string;
  description: string;
  path: string;
  shipped: boolean;
  problem: string | null;
  settings: Setting[];
}

export interface Plan extends Same {
  stages: { stage: string; uses: string; inputs: string[]; reason: string | null; what: string; finished: string | null; seconds: number | null }[];
  problem: { setting: string | null; message: string } | null;
}

export interface Run {
  run: string;
  pipeline: string;
  state: string;
  begun: string;
  seconds: number;
  version: number | null;
  problem: string | null;
  kinedex: string;
  written_by: string;
  settings: Record<string, unknown>;
  stages: { stage: string; state: string; reason: string; seconds: number }[];
  reports: string[];
  views: string[];
  current: boolean;
}

export interface Measured {
  pipeline: string;
  stage: string;
  evaluation: string;
  f1: number | null;
  p1: number | null;
  r1: number | null;
  f2: number | null;
  p2: number | null;
  r2: number | null;
}
