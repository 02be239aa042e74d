import { expect, test } from "vitest";

import { type Change, currentLabels, decisionOn, type LabelRow, replacedBy, withChanges } from "./edits";

const shown = (rows: readonly LabelRow[]) =>
  currentLabels(rows)
    .map((row) => `${row.class}[${row.start}:${row.stop}]${row.verdict === "negative" ? "-" : ""}`)
    .sort();

const after = (rows: readonly LabelRow[], ...changes: Change[]) => withChanges(rows, changes, "ann");

const TWO: Change[] = [
  { do: "draw", id: "a", class: "walk", start: 0, stop: 8 },
  { do: "draw", id: "b", class: "walk", start: 9, stop: 20 },
];

test("edits show at once what the server records", () => {
  const rows = after([], ...TWO);
  expect(shown(after(rows, { do: "change", id: "c", label: "a", class: "run", stop: 7 }))).toEqual(["run[0:7]", "walk[9:20]"]);
  expect(shown(after(rows, { do: "split", ids: ["c", "d"], label: "b", at: 15 }))).toEqual(["walk[0:8]", "walk[15:20]", "walk[9:15]"]);
  expect(shown(after(rows, { do: "join", ids: ["c", "d"], labels: ["a", "b"] }))).toEqual(["walk[0:20]"]);
  expect(shown(after(rows, { do: "withdraw", id: "c", label: "a" }))).toEqual(["walk[9:20]"]);
  expect(after(rows, ...TWO)).toEqual(rows);
});

test("a restore undoes an edit, and undoes itself", () => {
  const rows = after([], ...TWO);
  const edits: Change[] = [
    { do: "split", ids: ["c", "d"], label: "b", at: 15 },
    { do: "join", ids: ["c", "d"], labels: ["a", "b"] },
  ];
  for (const edit of edits) {
    const edited = after(rows, edit);
    const undone = after(edited, { do: "restore", ids: ["e", "f", "g"], made: ["c", "d"], back: replacedBy([edit]) });
    expect(shown(undone)).toEqual(shown(rows));
    const made = undone.slice(edited.length).map((row) => row.id);
    expect(shown(after(undone, { do: "restore", ids: ["h", "i", "j"], made, back: ["c", "d"] }))).toEqual(shown(edited));
  }
});

test("an annotation is decided on once, and the other way by a second decision", () => {
  const annotation = { class: "kick", subclass: "kickLeft", start: 3, stop: 9, cost: 0.1, confidence: 0.5 };
  const decision = { stage: "p/annotate", class: "kick", subclass: "kickLeft", start: 3, stop: 9, seen: null };
  const rows = after([], { do: "accept", id: "a", ...decision }, { do: "accept", id: "b", ...decision });
  expect(shown(rows)).toEqual(["kickLeft[3:9]"]);
  expect(decisionOn(annotation, currentLabels(rows))?.id).toBe("a");
  expect(shown(after(rows, { do: "reject", id: "c", ...decision, seen: "a" }))).toEqual(["kick[3:9]-"]);
});
