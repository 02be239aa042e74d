import { expect, test } from "vitest";

import { addPose, nextState, stateOf, withoutPose, withState } from "./poses";
import type { Query } from "./types";

const EMPTY: Query = { name: "q", poses: [], gaps: [] };

test("a click goes from any to on to off and back", () => {
  let pose = { on: [] as string[], off: ["b"] };
  const states = [0, 1, 2, 3].map(() => {
    pose = withState(pose, "a", nextState(stateOf(pose, "a")));
    return stateOf(pose, "a");
  });
  expect(states).toEqual(["on", "off", "any", "on"]);
  expect(pose.off).toEqual(["b"]);
});

test("a query has one gap fewer than poses, whichever pose goes", () => {
  const three = ["a", "b", "c"].reduce<Query>((query, name) => addPose(query, { on: [name], off: [] }), EMPTY);
  expect(three.gaps).toHaveLength(2);
  for (const place of [0, 1, 2]) {
    const two = withoutPose(three, place);
    expect(two.poses).toHaveLength(2);
    expect(two.gaps).toHaveLength(1);
  }
  expect(withoutPose(three, 1).gaps[0]).toEqual({ low: 0.2, high: 2 });
  expect(withoutPose(withoutPose(withoutPose(three, 0), 0), 0)).toEqual(EMPTY);
});
