import { expect, test } from "vitest";

import { type ArchiveMap, clusterName, inside, legendOf, nearest, neighbour, NO_FIT, NO_VALUE, packedIds, takesOf, unpackedIds } from "./map";

const cluster = { points: 2, takes: 2, hours: 1, title: "kick", words: "", traits: [], classes: [], typical: [0], outline: [] };
const map: ArchiveMap = {
  unit: "takes",
  version: 1,
  takes: [3, 7, 9, 12],
  names: ["a", "b", "c", "d"],
  owner: [0, 1, 2, 3],
  starts: [0, 0, 0, 0],
  stops: [9, 9, 9, 9],
  x: [0, 1, 0.4, -1],
  y: [0, 0, 0.2, 0.9],
  cluster: [0, 0, -1, -1],
  clusters: [cluster as ArchiveMap["clusters"][number]],
  window_seconds: null,
  remarks: [],
};
const all = () => true;

test("ids are packed into bits and back", () => {
  expect(packedIds([1, 3])).toBe("UA"); // 0101 0000
  for (const ids of [[], [0], [7, 8, 9], [1, 63, 64, 1000, 99_999]]) expect(unpackedIds(packedIds(ids))).toEqual(ids);
  expect(packedIds([248, 249, 250, 251, 252, 253, 254, 255])).not.toMatch(/[+/=]/);
  expect(unpackedIds("no base64 !")).toEqual([]);
});

test("arrows lead to the nearest point ahead, and stay where there is none", () => {
  expect(neighbour(map, 0, "ArrowRight", all)).toBe(2);
  expect(neighbour(map, 0, "ArrowRight", (point) => point !== 2)).toBe(1);
  expect(neighbour(map, 0, "ArrowLeft", all)).toBe(3);
  expect(neighbour(map, 0, "ArrowDown", all)).toBe(0);
});

test("a click finds what is close enough, a polygon what is inside", () => {
  expect(nearest(map, [0.9, 0.05], 0.2, all)).toBe(1);
  expect(nearest(map, [0.7, 0.7], 0.2, all)).toBe(-1);
  expect(inside(map, [[-0.1, -0.1], [0.5, -0.1], [0.5, 0.5], [-0.1, 0.5]], all)).toEqual([0, 2]);
  expect(takesOf(map, [2, 0])).toEqual([3, 9]);
});

test("points have colours by value, by cluster or by ranges of numbers", () => {
  const values = { column: "class", takes: 3, values: ["kick", "walk"], codes: [0, 1, NO_VALUE, NO_FIT] };
  const legend = legendOf(map, values, "column");
  expect([legend.labels, legend.counts, [...legend.codes]]).toEqual([["kick", "walk"], [1, 1], [0, 1, NO_VALUE, NO_FIT]]);
  expect([...legendOf(map, values, "cluster").codes]).toEqual([0, 0, NO_VALUE, NO_FIT]);
  const unnamed = { ...(map.clusters[0] as ArchiveMap["clusters"][number]), title: "no class", traits: [{ feature: "root fast", share: 0, rest: 0.5 }] };
  expect(clusterName(unnamed, 2)).toBe("3: no class, not root fast");
  const numbers = legendOf(map, { column: "seconds", takes: 3, numbers: [1, 2, 10, null], fits: [1, 1, 1, 0] }, "column");
  expect(numbers.labels).toEqual(["1 to below 2", "2 to below 10", "10 to 10"]);
  expect([...numbers.codes]).toEqual([0, 1, 2, NO_FIT]);
  const many = { column: "x", takes: 4, values: Array.from({ length: 30 }, (_, i) => `${i}`), codes: [0, 17, 18, 29] };
  expect([...legendOf(map, many, "column").codes]).toEqual([0, 17, 18, 18]);
});
