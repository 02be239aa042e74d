import { expect, test } from "vitest";

import { fits, template } from "./lines";

const widths = Float32Array.from({ length: 127 }, () => 7);

test("a text fits if it is surely narrower than its column", () => {
  expect(fits("", 0, widths)).toBe(true);
  expect(fits("0123456789", 73, widths)).toBe(true);
  expect(fits("0123456789", 71, widths)).toBe(false);
  expect(fits("ö", 100, widths)).toBe(false); // of unknown width, so it is clipped
});

test("the first column of texts takes what is left", () => {
  expect(template([{ width: 60, numeric: true }, { width: 90 }, { width: 80 }])).toBe("60px minmax(90px, 1fr) 80px");
  expect(template([{ width: 60, numeric: true }])).toBe("minmax(60px, 1fr)");
});
