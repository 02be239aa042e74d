// What the server answers about templates and queries (explorer/{templates,edit_effect,learned_queries}.py).

import type { Same } from "../api/types";
import type { Hit, Query } from "../ask/types";

export interface ListRow {
  name: string;
  class: string;
  columns: number;
  seconds: number;
  clips: number;
  wildcards: number;
  origin: string;
  remarks: string[];
  /** Null where the method of the pipeline has no thresholds. */
  tau: number | null;
  /** A byte for each feature and column, in base64: 200 times the share of the clips in which the feature is on. */
  picture: string;
}

export interface TemplateList extends Same {
  stages: string[];
  templates: ListRow[];
  remarks: string[];
  stage?: string;
  kind?: string;
  kinds?: string[];
  delta?: number;
  annotate?: string | null;
  evaluate?: string | null;
  method?: string;
}

export interface Clip {
  name: string;
  take: string;
  take_id: number;
  start: number;
  stop: number;
  mirrored: boolean;
  to_others: number | null;
  to_template: number | null;
  far: boolean;
  /** For each column the frame of the take that shows it; null for a clip in the mirror. */
  frames: number[] | null;
}

export interface TemplateFacts extends Same {
  name: string;
  class: string;
  kind: string;
  stage: string;
  columns: number;
  seconds: number;
  values: number[][];
  weights: number[] | null;
  consistency: number[];
  clips: Clip[];
  missing: number;
  far: { limit: number; median: number; spread: number } | null;
  poses: number | null;
  delta: number;
  tau: number;
  rounds: number;
  remarks: string[];
  origin: string;
  heading: string;
}

export interface Difference extends Same {
  first: string;
  second: string;
  columns: [number, number][];
  values: number[][];
  share: number | null;
  features: { bit: number; name: string; difference: number; first: number; second: number; words: string }[];
  summary: string;
}

export interface EffectRow {
  template: "learned" | "edited";
  threshold: "pipeline" | "used" | "best";
  /** Null for a method without thresholds. */
  tau: number | null;
  p1: number | null;
  r1: number | null;
  f1: number | null;
  p2: number | null;
  r2: number | null;
  f2: number | null;
  segments_automatic: number;
  segments_automatic_hit: number;
  segments_manual: number;
  segments_manual_hit: number;
}

export interface Segments {
  total: number;
  segments: Hit[];
}

/** How well thresholds divide the training clips: F = scores[i] from taus[i] on, and the best τ. */
export interface Divided {
  taus: number[];
  scores: number[];
  tau: number;
  f: number;
}

export interface Effect extends Same {
  class: string;
  with: string[];
  method: string;
  /** True where keyframe queries of the pipeline are used, too. */
  queries: boolean;
  uses_tau: boolean;
  truth: {
    source: "evaluation" | "labels" | null;
    stage: string | null;
    takes: number;
    seconds: number;
    segments: number;
    all_takes: number;
    all_seconds: number;
    among_examples: number;
    sources: string[];
  };
  tau: number;
  pipeline_tau: number;
  training: { learned: Divided | null; edited: Divided | null };
  /** The setting for thresholds by class, where the best one is far better than that of the pipeline. */
  advice: string | null;
  rows: EffectRow[];
  wrong: Segments;
  missed: Segments;
  remarks: string[];
  missing: string;
  seconds: number;
  pipeline: string;
}

export interface LearnedQuery {
  name: string;
  class: string;
  origin: string;
  precision: number;
  recall: number;
  fitness: number;
  runs: number;
  clips: number;
  text: string;
  query: Query | null;
  sentence: string;
  seen: { take_id: number; take: string; frames: number[] } | null;
}

export interface QueryList extends Same {
  stages: string[];
  stage?: string;
  queries: LearnedQuery[];
}
