import { expect, test } from "vitest";

import { scoreAt } from "./ThresholdCurve";

test("a clip counts from above its distance", () => {
  const training = { taus: [0, 0.1, 0.3], scores: [0.5, 1, 0.8], tau: 0.2, f: 1 };
  expect([0, 0.05, 0.1, 0.11, 0.3, 0.4].map((tau) => scoreAt(training, tau))).toEqual([0, 0.5, 0.5, 1, 1, 0.8]);
});
