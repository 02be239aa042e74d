import { describe, expect, it } from "vitest";

import { bySide, nearest, sceneOf, upright } from "./scene";

describe("a scene of points", () => {
  it("turns the vertical axis of the file up, and stays right-handed", () => {
    expect(upright([1, 2, 3], "z")).toEqual([2, 3, 1]);
    expect(upright([1, 2, 3], "y")).toEqual([1, 2, 3]);
    expect(upright([1, 2, 3], "-y")).toEqual([1, -2, -3]);
    expect(upright([1, 2, 3], "x")).toEqual([3, 1, 2]);
  });

  it("has the size of a body, whatever the unit, and stays in sight when it moves", () => {
    const still = [[0, 0, 0], [0, 1700, 0], null] as const;
    const moved = [[9000, 0, 0], [9000, 1700, 0], [9000, 850, 0]] as const;
    expect(sceneOf([still, moved])).toEqual([
      [[0, -0.85, 0], [0, 0.85, 0], null],
      [[0, -0.85, 0], [0, 0.85, 0], [0, 0, 0]],
    ]);
  });

  it("may be without any point, or with a single one", () => {
    expect(sceneOf([[null]])).toEqual([[null]]);
    expect(sceneOf([[[5, 5, 5]]])).toEqual([[[0, 0, 0]]]);
  });

  it("finds the point under the pointer", () => {
    const points = [[0, 0], null, [10, 0]] as const;
    expect(nearest(points, 8, 1, 5)).toBe(2);
    expect(nearest(points, 5, 9, 5)).toBe(-1);
  });
});

describe("names", () => {
  it("have a side where there is a counterpart", () => {
    expect(bySide(["root", "lhip", "rhip", "lasis"])).toEqual({ left: ["lhip"], middle: ["root", "lasis"], right: ["rhip"] });
  });
});
