import { describe, expect, it } from "vitest";

import { pointsInSight, type Sight } from "./mapDetail";

const COUNT = 3000;
let state = 1;
const random = () => (state = (state * 48271) % 2147483647) / 2147483647;
const xs = Float32Array.from({ length: COUNT }, () => 2 * random() - 1);
const ys = Float32Array.from({ length: COUNT }, () => 2 * random() - 1);
const order = Uint32Array.from({ length: COUNT }, (_, i) => (i * 7) % COUNT);
const sights: Sight[] = [
  { x: 0, y: 0, reach: [2, 2] },
  { x: 0.3, y: -0.2, reach: [0.4, 0.25] },
  { x: 5, y: 5, reach: [1, 1] },
];

function found(sight: Sight, cell: number | null): number[] {
  const into = new Uint32Array(COUNT);
  return [...into.subarray(pointsInSight(order, xs, ys, sight, cell, into))];
}

/** The same, point by point: those in sight that no later one of their cell hides. */
function naive(sight: Sight, cell: number | null): number[] {
  const within = [...order].filter(
    (one) => Math.abs((xs[one] as number) - sight.x) <= sight.reach[0] && Math.abs((ys[one] as number) - sight.y) <= sight.reach[1],
  );
  if (cell === null) return within;
  const key = (one: number) => `${Math.floor((xs[one] as number) / cell)} ${Math.floor((ys[one] as number) / cell)}`;
  const last = new Map(within.map((one) => [key(one), one]));
  return within.filter((one) => last.get(key(one)) === one);
}

describe("the points of a picture of the map", () => {
  it("are all that are in sight, or the last of each cell", () => {
    for (const sight of sights) for (const cell of [null, 0.01, 0.13, 3]) expect(found(sight, cell)).toEqual(naive(sight, cell));
    expect(found(sights[0] as Sight, null)).toEqual([...order]);
    expect(found(sights[0] as Sight, 0.13).length).toBeLessThan(300);
  });

  it("of a cell stay the same while the map moves", () => {
    const both = [{ ...(sights[1] as Sight) }, { ...(sights[1] as Sight), x: 0.317 }].map((sight) => new Set(found(sight, 0.05)));
    const [one, other] = both as [Set<number>, Set<number>];
    const inner = [...one].filter((point) => Math.abs((xs[point] as number) - 0.3) < 0.3 && Math.abs((ys[point] as number) + 0.2) < 0.2);
    expect(inner.length).toBeGreaterThan(20);
    expect(inner.every((point) => other.has(point))).toBe(true);
  });
});
