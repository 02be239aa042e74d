// What the server states about a take (explorer/take_lanes.py and curves.py).

import type { Same, Value } from "../api/types";

export interface TakeDocument extends Same {
  take_id: number;
  name: string;
  frames: number;
  rate_hz: number;
  seconds: number;
  version: number;
  columns: Record<string, Value>;
  /** Bits of the features that the body lacks joints for. */
  unknown: number[];
  warnings: string[];
  persons: { take_id: number; name: string; frames: number }[];
}

export interface Segment {
  start: number;
  stop: number;
  class?: string;
  subclass?: string;
  cost?: number;
  confidence?: number;
  verdict?: string;
  [name: string]: Value | undefined;
}

export type LaneGroup =
  | "labels"
  | "ground_truth"
  | "annotations"
  | "compared"
  | "hits"
  | "limbs"
  | "duplicates"
  | "quality";

export interface Lane {
  id: string;
  group: LaneGroup;
  name: string;
  detail: string;
  segments: Segment[];
}

export interface Suspect {
  figure: string;
  value: number;
  low: number | null;
  high: number | null;
  unit: string;
  meaning: string;
}

/** A limb with a curve of errors against its sensor, and the error above which it is wrong. */
export interface ErrorLimb {
  limb: string;
  tau_deg: number | null;
}

export interface TakeLanes extends Same {
  lanes: Lane[];
  suspect: Suspect[];
  limbs: ErrorLimb[];
}

export interface OfferedTemplate {
  name: string;
  kind: "soft" | "hard";
  stage: string;
  columns: number;
  clips: number;
  applied: boolean;
}

export interface TakeTemplates extends Same {
  templates: OfferedTemplate[];
  tau: number;
  tau_by_class: Record<string, number>;
  delta: number;
  found: string[];
}

export interface TemplateImage extends Same {
  name: string;
  columns: number;
  /** For each feature its value in each column, 0 to 1. */
  values: number[][];
  clips: string[];
}

/** The hit of a template that is nearest to a frame, with how the template fits it. */
export interface FittedHit extends Same {
  start: number;
  stop: number;
  cost: number;
  below: boolean;
  /** The column of the template in each frame. */
  columns: number[];
  example: { take_id: number; take: string; start: number; stop: number; cost: number | null; frames: number[] } | null;
}

export interface Aligned extends Same {
  start: number;
  stop: number;
  /** Frames of the other take, one for each frame of this one. */
  frames: number[];
  cost: number;
}
