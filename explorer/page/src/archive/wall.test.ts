import { expect, test } from "vitest";

import { lineOf, shownFrames, takeBelow, takeOfGroup, type WallGroup, wallLines } from "./wall";

const groups: WallGroup[] = [
  { value: "jig", takes: 5, hours: 1 },
  { value: "reel", takes: 1, hours: 1 },
  { value: null, takes: 4, hours: 1 },
];
const lines = wallLines(groups, 3, true);

test("a line holds takes of one group below its heading", () => {
  const rows = lines.map((line) => (line.kind === "heading" ? groups[line.group]?.value : [line.first, line.stop]));
  expect(rows).toEqual(["jig", [0, 3], [3, 5], "reel", [5, 6], null, [6, 9], [9, 10]]);
  expect(wallLines([{ value: undefined, takes: 4, hours: 1 }], 3, false)).toHaveLength(2);
  expect(wallLines([], 3, true)).toEqual([]);
});

test("every take has a line", () => {
  expect(Array.from({ length: 11 }, (_, take) => lineOf(lines, take))).toEqual([1, 1, 1, 2, 2, 4, 6, 6, 6, 7, -1]);
  expect(lineOf([], 0)).toBe(-1);
});

test("arrows go to the nearest take of the row below or above", () => {
  expect(takeBelow(lines, 1, 1)).toBe(4);
  expect(takeBelow(lines, 2, 1)).toBe(4);
  expect(takeBelow(lines, 4, 1)).toBe(5);
  expect(takeBelow(lines, 5, -1)).toBe(3);
  expect(takeBelow(lines, 0, -1)).toBe(0);
  expect(takeBelow(lines, 0, 99)).toBe(9);
});

test("groups are left by their first takes", () => {
  expect([0, 5, 6].map((take) => takeOfGroup(groups, take, 1))).toEqual([5, 6, 6]);
  expect([0, 4, 5, 8].map((take) => takeOfGroup(groups, take, -1))).toEqual([0, 0, 0, 6]);
});

test("of a long take the middle is shown", () => {
  expect(shownFrames(100, 30)).toEqual([0, 100]);
  expect(shownFrames(1000, 30)).toEqual([380, 620]);
});
