import { expect, test } from "vitest";

import { duration, parametersOf, reportAddress } from "./text";

test("parameters are one a line", () => {
  expect(parametersOf("annotate.tau=0.06\n\n a.where = x = 'y' ")).toEqual({ values: { "annotate.tau": "0.06", "a.where": "x = 'y'" }, wrong: null });
  expect(parametersOf("tau").wrong).toBe("tau");
});

test("durations and addresses of reports", () => {
  expect(duration(3.21)).toBe("3.2 s");
  expect(duration(125)).toBe("2 min 5 s");
  expect(reportAddress("own/a report?.html")).toBe("/api/reports/own/a%20report%3F.html");
});
