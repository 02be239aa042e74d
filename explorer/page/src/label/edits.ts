// Edits of the labels of a take as the page shows them at once; pipelines/labels/label_edits.py records the same on the server.

export interface LabelRow {
  id: string;
  class: string;
  start: number;
  stop: number;
  limb: string | null;
  verdict: "positive" | "negative" | "withdrawn";
  origin: string;
  annotator: string | null;
  created: string | null;
  confidence: number | null;
  note: string | null;
  source: string | null;
  replaces: string | null;
  file_changed?: boolean | null;
}

export interface Annotation {
  class: string;
  subclass: string | null;
  start: number;
  stop: number;
  cost: number | null;
  confidence: number | null;
}

/** What a person does to the labels of a take. */
export interface Edits {
  draw: (label: string, start: number, stop: number) => void;
  change: (label: LabelRow, values: { class?: string; start?: number; stop?: number; verdict?: "positive" | "negative" }) => void;
  split: (label: LabelRow) => void;
  join: (label: LabelRow) => void;
  withdraw: (label: LabelRow) => void;
  decide: (annotation: Annotation, accept: boolean) => void;
  correct: (annotation: Annotation) => void;
  undo: () => void;
  redo: () => void;
}

type Verdict = "positive" | "negative";

export type Change =
  | { do: "draw"; id: string; class: string; start: number; stop: number; verdict?: Verdict }
  | { do: "change"; id: string; label: string; class?: string; start?: number; stop?: number; verdict?: Verdict }
  | { do: "split"; ids: [string, string]; label: string; at: number }
  | { do: "join"; ids: string[]; labels: string[] }
  | { do: "withdraw"; id: string; label: string }
  | {
      do: "accept" | "reject";
      id: string;
      stage: string;
      class: string;
      subclass: string | null;
      start: number;
      stop: number;
      seen: string | null;
    }
  | { do: "restore"; ids: string[]; made: string[]; back: string[] };

/** Return a new id of a label: 32 hexadecimal digits. */
export function newId(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((one) => one.toString(16).padStart(2, "0")).join("");
}

/** Return the labels that count: rows that no other replaces, without those that withdraw another. */
export function currentLabels(rows: readonly LabelRow[]): LabelRow[] {
  const replaced = new Set(rows.map((row) => row.replaces));
  return rows.filter((row) => !replaced.has(row.id) && row.verdict !== "withdrawn");
}

/** Return the label that decides on an annotation: of its class or subclass, with its edges. */
export function decisionOn(annotation: Annotation, labels: readonly LabelRow[]): LabelRow | undefined {
  return labels.find(
    (one) =>
      one.start === annotation.start &&
      one.stop === annotation.stop &&
      one.limb === null &&
      (one.class === annotation.class || one.class === annotation.subclass),
  );
}

/** Return the label that decides on an annotation as the queue of the server counts it (`doubtful.with_verdicts`): the
 * one with its edges; or a corrected one that overlaps it; or one of the class that shares half of the frames of both. */
export function verdictOn(annotation: Annotation, labels: readonly LabelRow[]): LabelRow | undefined {
  const decides = (one: LabelRow) => {
    if (one.limb !== null || (one.class !== annotation.class && one.class !== annotation.subclass)) return false;
    const common = Math.min(one.stop, annotation.stop) - Math.max(one.start, annotation.start);
    const whole = Math.max(one.stop, annotation.stop) - Math.min(one.start, annotation.start);
    return common > 0 && (one.origin === "corrected" || (one.verdict === "positive" && 2 * common >= whole));
  };
  return decisionOn(annotation, labels) ?? labels.find(decides);
}

/** Return all rows after some changes; a change whose label is not known leaves them as they are. */
export function withChanges(rows: readonly LabelRow[], changes: readonly Change[], annotator: string): LabelRow[] {
  const found = [...rows];
  const known = new Map(found.map((row) => [row.id, row]));
  const add = (row: LabelRow) => {
    found.push(row);
    known.set(row.id, row);
  };
  for (const change of changes) {
    const first = "ids" in change ? change.ids[0] : change.id;
    if (first === undefined || known.has(first)) continue;
    for (const row of rowsOf(change, known, found, annotator)) add(row);
  }
  return found;
}

const EMPTY = { limb: null, created: null, confidence: null, note: null, source: null, replaces: null } as const;

function rowsOf(change: Change, known: Map<string, LabelRow>, rows: readonly LabelRow[], annotator: string): LabelRow[] {
  const after = (id: string, label: string, values: Partial<LabelRow>): LabelRow[] => {
    const before = known.get(label);
    if (before === undefined) return [];
    return [{ ...before, confidence: null, origin: "corrected", annotator, created: null, ...values, id, replaces: label }];
  };
  const withdrawn = (id: string, label: string) =>
    after(id, label, { verdict: "withdrawn", origin: known.get(label)?.origin ?? "" });
  switch (change.do) {
    case "draw": {
      const { id, start, stop, verdict = "positive" } = change;
      return [{ ...EMPTY, id, class: change.class, start, stop, verdict, origin: "drawn", annotator }];
    }
    case "change": {
      const { id, label, do: _, ...values } = change;
      return after(id, label, values);
    }
    case "split":
      return [
        ...after(change.ids[0], change.label, { stop: change.at }),
        ...after(change.ids[1], change.label, { start: change.at }),
      ];
    case "join": {
      const parts = change.labels.map((one) => known.get(one)).filter((one) => one !== undefined);
      const start = Math.min(...parts.map((one) => one.start));
      const stop = Math.max(...parts.map((one) => one.stop));
      const others = change.labels.slice(1).flatMap((one, i) => withdrawn(change.ids[i + 1] ?? "", one));
      return [...others, ...after(change.ids[0] ?? "", change.labels[0] ?? "", { start, stop })];
    }
    case "withdraw":
      return withdrawn(change.id, change.label);
    case "accept":
    case "reject": {
      const verdict = change.do === "accept" ? "positive" : "negative";
      const standing = decisionOn({ ...change, cost: null, confidence: null }, currentLabels(rows));
      if (standing?.verdict === verdict) return [];
      const label = change.do === "accept" ? (change.subclass ?? "") || change.class : change.class;
      const { id, start, stop, stage } = change;
      const more = { verdict, origin: "accepted", annotator, source: stage, replaces: standing?.id ?? null } as const;
      return [{ ...EMPTY, ...more, id, class: label, start, stop }];
    }
    case "restore":
      return restored(change, known, annotator);
  }
}

/** Return the rows that undo the edit which made some rows; ids are used up in the order of the server. */
function restored(change: Change & { do: "restore" }, known: Map<string, LabelRow>, annotator: string): LabelRow[] {
  const ids = [...change.ids];
  const left = new Map(change.made.flatMap((id) => (known.has(id) ? [[id, known.get(id) as LabelRow] as const] : [])));
  const found: LabelRow[] = [];
  for (const id of change.back) {
    const before = known.get(id);
    if (before === undefined || before.verdict === "withdrawn") continue;
    const undone = [...left.values()].find((row) => row.replaces === id) ?? [...left.values()][0];
    if (undone !== undefined) left.delete(undone.id);
    found.push({ ...before, created: null, id: ids.shift() ?? "", replaces: undone?.id ?? null });
  }
  for (const row of left.values())
    if (row.verdict !== "withdrawn")
      found.push({ ...row, confidence: null, annotator, created: null, verdict: "withdrawn", id: ids.shift() ?? "", replaces: row.id });
  return found;
}

/** Return the ids of the rows that changes make; those of a restore are the server's to tell. */
export function madeBy(changes: readonly Change[]): string[] {
  return changes.flatMap((one) => (one.do === "restore" ? [] : "ids" in one ? one.ids : [one.id]));
}

/** Return the ids of the labels in whose place the rows of changes come. */
export function replacedBy(changes: readonly Change[]): string[] {
  return changes.flatMap((one) => {
    if ("label" in one) return [one.label];
    if ("labels" in one) return one.labels;
    return "seen" in one && one.seen !== null ? [one.seen] : [];
  });
}
