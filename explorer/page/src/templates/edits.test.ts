import { expect, test } from "vitest";

import { askAddress, isEdited, soundColumns, soundWeights, spreadsAbove, weightAfter } from "./edits";

test("weights of an address are numbers that change something", () => {
  expect(soundWeights({ rhand_fast: 0, lhand_fast: 1, bent: 2.5, wrong: "3", less: -1, more: 1001 })).toEqual({
    rhand_fast: 0,
    bent: 2.5,
  });
  for (const given of [null, [1], "x", 3]) expect(soundWeights(given)).toEqual({});
});

test("columns of an address lie within the template, and one is left", () => {
  expect(soundColumns("3", "20", 30)).toEqual([3, 20]);
  expect(soundColumns(null, "99", 30)).toEqual([0, 30]);
  expect(soundColumns("30", null, 30)).toEqual([0, 30]);
  expect(soundColumns("-1", "x", 30)).toEqual([0, 30]);
});

test("a template is edited by weights, columns or the threshold", () => {
  const none = { weights: {}, first: 0, stop: 30, tau: null };
  expect(isEdited(none, 30)).toBe(false);
  expect(isEdited({ ...none, tau: 0.1 }, 30)).toBe(true);
  expect(isEdited({ ...none, first: 1 }, 30)).toBe(true);
  expect(isEdited({ ...none, weights: { rhand_fast: 0 } }, 30)).toBe(true);
});

test("clips become examples of the page Ask", () => {
  const clip = { name: "a", take: "a&b", take_id: 1, start: 2, stop: 9, mirrored: true, to_others: null, to_template: null, far: false, frames: null };
  const asked = new URLSearchParams(askAddress([clip]).split("?")[1]);
  expect(asked.get("way")).toBe("example");
  expect(JSON.parse(asked.get("more") as string)).toEqual([["a&b", 2, 9, 1]]);
});

test("a cost is so many spreads above the median", () => {
  expect(spreadsAbove(0.3, { median: 0.1, spread: 0.05 })).toBeCloseTo(4);
  expect(spreadsAbove(0.3, { median: 0.1, spread: 0 })).toBeNull();
});

test("keys turn a feature off and on, and change its weight", () => {
  expect([weightAfter("x", 2), weightAfter("x", 0), weightAfter("+", 1), weightAfter("-", 0.25)]).toEqual([0, 1, 1.5, 0]);
  expect(weightAfter("a", 1)).toBeNull();
});
