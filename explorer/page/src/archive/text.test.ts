import { expect, test } from "vitest";

import { filterText, hours, reasonOf, shown } from "./text";

test("a message stands beside the file and the line that it begins with", () => {
  expect(reasonOf("/data/a.bvh:3: expected X", "a.bvh")).toBe("expected X");
  expect(reasonOf("/data/a.bvh: the file is empty", "a.bvh")).toBe("the file is empty");
  expect(reasonOf("no skeleton", "a.bvh")).toBe("no skeleton");
  expect(reasonOf("no skeleton", "")).toBe("no skeleton");
});

test("a chip states its filter", () => {
  expect(filterText({ column: "class", values: ["kick", null] })).toBe("class: kick, none");
  expect(filterText({ column: "class", values: ["a", "b", "c", "d"] })).toBe("class: a, b, c and 1 more");
  expect(filterText({ column: "seconds", min: 1.5 })).toBe("seconds: at least 1.5");
  expect(filterText({ column: "seconds", min: 1, max: 2 })).toBe("seconds: 1 to 2");
  expect(filterText({ column: "name", contains: "<b>" })).toBe("name: contains “<b>”");
  expect(filterText({ column: "take_id", chosen: "UA" })).toBe("chosen on the map: 2 takes");
});

test("durations and values are short", () => {
  expect([0, 4.447, 0.2, 0.001].map(hours)).toEqual(["0.00 h", "4.45 h", "12.0 min", "3.6 s"]);
  expect([null, 3, 0.123456, ["a", "b"], true].map(shown)).toEqual(["", "3", "0.1235", "a; b", "true"]);
});
