import { expect, test } from "vitest";

import { nearestFrame, shownSeconds } from "./seconds";

test("seconds of frames are rounded to hundredths, halves upwards", () => {
  expect([shownSeconds(680, 30), shownSeconds(15, 120), shownSeconds(3, 120), shownSeconds(45, 30, 1)]).toEqual(["22.67", "0.13", "0.03", "1.5"]);
});

test("a time is the nearest frame, of two the later", () => {
  expect([nearestFrame(0.05, 30), nearestFrame(22.67, 30), nearestFrame(0, 30)]).toEqual([2, 680, 0]);
});
