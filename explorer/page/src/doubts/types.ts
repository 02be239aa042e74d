// What the server says about doubts and about the files that they are of.

import type { Job, Same } from "../api/types";

export type Kind = "refused" | "guessed" | "warned";

export interface Cause {
  kind: Kind;
  cause: string;
  files: number;
  accepted: number;
}

export type Causes = Same & { causes: Cause[]; total: number };

export interface DoubtRow {
  source_root: string | null;
  source: string;
  take: string | null;
  message: string;
  accepted: boolean;
}

export type DoubtRows = Same & { rows: DoubtRow[]; total: number };

export interface SourceFile {
  source_root: string;
  source: string;
  /** The person of a file of several; empty for the first, or for a file of one. */
  person: string;
}

export type Place = readonly [number, number, number];
/** The places of some points in some frames; null where one is not seen. */
export type Frames = readonly (readonly (Place | null)[])[];

export interface NodeGuess {
  node: string;
  name: string;
  reason: string;
  joints: string[];
}

export type Nodes = Same & {
  format: string;
  nodes: NodeGuess[];
  names: string[];
  can_be_named: boolean;
  parents: number[] | null;
  frames: Frames;
  up: string;
  persons: string[];
  person: string;
  refused: string | null;
  proposed_name: string;
};

export interface FigureBeside {
  figure: string;
  meaning: string;
  unit: string;
  value: number | null;
  limits: string;
  off: boolean;
  advice: string;
  /** Least, median and greatest value of the takes around. */
  around: [number, number, number] | null;
}

export interface WordBeside {
  feature: string;
  percent: number | null;
  around: number | null;
}

export interface Trial {
  yaml: string;
  fault: string | null;
  frames: Frames;
  joints?: string[];
  parents?: number[];
  unknown: string[];
  estimated: string[];
  figures: FigureBeside[];
  words: WordBeside[];
  warnings: string[];
  around: { folder: string; takes: number };
  commands: string[];
}

export interface Kept {
  name: string;
  replaced: boolean;
  job: Job;
  commands: string[];
}

/** Node → joint, landmark, or `none`. */
export type Named = Record<string, string>;
