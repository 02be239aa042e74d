import { expect, test } from "vitest";

import { type Interval, keyOf, samePlace } from "./types";
import { decided, marksOf, type Verdict } from "./verdicts";

const at = (start: number, stop: number, take = "a", mirrored = false): Interval => ({ take, start, stop, mirrored });

/** Count the frames that two intervals share, one by one. */
function isSame(one: Interval, other: Interval): boolean {
  let shared = 0;
  for (let frame = one.start; frame < one.stop; frame++)
    if (one.take === other.take && frame >= other.start && frame < other.stop) shared++;
  return 2 * shared >= Math.min(one.stop - one.start, other.stop - other.start) && shared > 0;
}

test("two intervals are of one place where they share half of the shorter", () => {
  for (let start = 0; start < 12; start++)
    for (let stop = start + 1; stop <= 12; stop++)
      for (const take of ["a", "b"])
        for (const other of [at(3, 9), at(5, 6), at(0, 12)])
          expect(samePlace(at(start, stop, take), other)).toBe(isSame(at(start, stop, take), other));
});

test("a hit has its own verdict, or that of the interval that shares most with it", () => {
  const verdicts: Record<string, Verdict> = { [keyOf(at(0, 10))]: "yes", [keyOf(at(7, 19))]: "no" };
  const of = marksOf(verdicts);
  expect(of(at(0, 10))).toEqual({ verdict: "yes", earlier: false });
  expect(of(at(0, 10, "a", true))).toEqual({ verdict: "yes", earlier: true });
  expect(of(at(8, 18))).toEqual({ verdict: "no", earlier: true });
  expect(of(at(5, 13))).toEqual({ verdict: "no", earlier: true });
  expect(of(at(18, 40))).toBeUndefined();
  expect(of(at(0, 10, "b"))).toBeUndefined();
});

test("a place has one verdict: the last one", () => {
  const first = decided({}, at(0, 10), "yes");
  const second = decided(decided(first, at(20, 30), "yes"), at(2, 11), "no");
  expect(second).toEqual({ [keyOf(at(20, 30))]: "yes", [keyOf(at(2, 11))]: "no" });
  expect(decided(second, at(1, 12), null)).toEqual({ [keyOf(at(20, 30))]: "yes" });
});
