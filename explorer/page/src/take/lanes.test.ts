import { describe, expect, it } from "vitest";

import { takeAddress, takeName } from "../app/address";
import { clock, frameAt, pinched, showing, ticks, within, xOf, zoomed } from "./axis";
import { partnerOf } from "./pairing";
import { makeRows, rowAt, segmentAt, stacked } from "./rows";
import { ordered, Session } from "./session";
import type { Lane } from "./types";
import { Words } from "./words";

describe("the axis of time", () => {
  it("what two fingers hold stays under them", () => {
    const view = { from: 100, to: 300 };
    for (const [before, after] of [[[100, 300], [50, 380]], [[300, 100], [310, 250]], [[10, 200], [60, 250]]] as [number, number][][]) {
      const next = pinched(view, before as [number, number], after as [number, number], 400);
      for (const finger of [0, 1])
        expect(frameAt(next, (after as number[])[finger] as number, 400)).toBeCloseTo(
          frameAt(view, (before as number[])[finger] as number, 400),
        );
    }
    expect(pinched(view, [100, 101], [100, 99], 400)).toBe(view);
  });

  it("zooms around a frame that stays where it is", () => {
    const view = zoomed({ from: 0, to: 1000 }, 4, 300, 1000);
    expect(view.to - view.from).toBe(250);
    expect(xOf(view, 300, 800)).toBeCloseTo(xOf({ from: 0, to: 1000 }, 300, 800));
    expect(frameAt(view, xOf(view, 321, 800), 800)).toBeCloseTo(321);
  });

  it("stays within the take, and never closer than a few frames", () => {
    expect(within({ from: -50, to: 50 }, 1000)).toEqual({ from: 0, to: 100 });
    expect(within({ from: 990, to: 1090 }, 1000)).toEqual({ from: 900, to: 1000 });
    expect(zoomed({ from: 0, to: 1000 }, 1e9, 500, 1000)).toEqual({ from: 496, to: 504 });
    expect(within({ from: 0, to: 50 }, 3)).toEqual({ from: 0, to: 3 });
  });

  it("turns the page where the playhead leaves it", () => {
    const view = { from: 100, to: 200 };
    expect(showing(view, 150, 1000)).toBe(view);
    expect(showing(view, 205, 1000)).toEqual({ from: 195, to: 295 });
    expect(showing(view, 50, 1000)).toEqual({ from: 0, to: 100 });
  });

  it("has round seconds as ticks", () => {
    expect(ticks({ from: 0, to: 300 }, 30, 800)).toEqual([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
    expect(ticks({ from: 0, to: 36000 }, 30, 1000).slice(0, 3)).toEqual([0, 120, 240]);
    expect([clock(3.14159), clock(75.04), clock(600, 0)]).toEqual(["3.1 s", "1:15.0", "10:00"]);
  });
});

describe("words", () => {
  const lost = 0xffffffffffffffffn;
  const values = [0n, 1n, 1n, lost, 1n | (1n << 39n), 1n << 39n];
  const words = new Words(new BigUint64Array(values).buffer as ArrayBuffer, 40);
  while (!words.prepare());

  it("count the frames in which a feature is on, and those that are invalid", () => {
    expect([words.onWithin(0, 0, 6), words.onWithin(0, 1, 3), words.onWithin(39, 0, 6)]).toEqual([3, 2, 2]);
    expect([words.lostWithin(0, 6), words.lostWithin(4, 6)]).toEqual([1, 0]);
  });

  it("have runs that invalid frames end", () => {
    expect(words.runs(0)).toEqual([{ start: 1, stop: 3 }, { start: 4, stop: 5 }]);
    expect(words.runAt(0, 3)).toEqual({ start: 3, stop: 4, state: "invalid" });
    expect(words.runAt(39, 5)).toEqual({ start: 4, stop: 6, state: "on" });
  });
});

describe("rows", () => {
  const segments = [
    { start: 0, stop: 10, class: "a" },
    { start: 5, stop: 8, class: "b" },
    { start: 10, stop: 12, class: "c" },
  ];
  const lane: Lane = { id: "labels/positive", group: "labels", name: "Labels", detail: "", segments };
  const features = [{ bit: 0, name: "rhand_fast", group: "upper", description: "right hand fast" }];

  it("put segments that overlap below each other", () => {
    expect(stacked(segments)).toEqual({ lines: [0, 1, 0], count: 2 });
    const rows = makeRows([lane], [], features, new Set([0]), new Set());
    expect(rows.map((row) => row.kind)).toEqual(["group", "segments", "group", "feature"]);
    const row = rows[1];
    if (row?.kind !== "segments") throw new Error("no lane");
    expect(segmentAt(row, 6, 25)?.class).toBe("b");
    expect(segmentAt(row, 9, 25)).toBeNull();
    expect(segmentAt(row, 9, 5)?.class).toBe("a");
    expect(rowAt(rows, row.y + 1)).toBe(row);
  });

  it("leave out what a closed group holds", () => {
    const rows = makeRows([lane], [], features, new Set(), new Set(["labels"]));
    expect(rows.map((row) => row.kind)).toEqual(["group", "group", "feature"]);
  });
});

it("a selection is a range of whole frames of the take, at least one", () => {
  expect(ordered([5.7, 2.2], 100)).toEqual([2, 6]);
  expect(ordered([3, 3], 100)).toEqual([3, 4]);
  expect(ordered([-5, 500], 100)).toEqual([0, 100]);
  expect(ordered([99.9, 120], 100)).toEqual([99, 100]);
});

it("a frame has its partner on a path, between two frames where they follow each other", () => {
  const pairing = { start: 10, stop: 14, frames: [0, 2, 2, 90] };
  expect([10, 10.5, 11.5, 12.5, 99, 0].map((frame) => partnerOf(pairing, frame))).toEqual([0, 1, 2, 2, 90, 0]);
});

it("a session seeks within its take, and shows the frame under the pointer meanwhile", () => {
  const waiting: FrameRequestCallback[] = [];
  Object.assign(globalThis, { requestAnimationFrame: (one: FrameRequestCallback) => waiting.push(one) });
  const session = new Session(100, 30);
  session.seek(500);
  expect(session.seen).toBe(99);
  session.hover(20);
  expect([session.seen, session.frame]).toEqual([20, 99]);
  session.hover(null);
  expect(session.seen).toBe(99);
  session.select([70, 40]);
  expect(session.shown.selection).toEqual([40, 70]);
  session.play();
  expect(session.frame).toBe(40);
  waiting.at(-1)?.(performance.now() + 200);
  expect(session.frame).toBeGreaterThan(44);
});

it("a take's address leads back to its name, whatever it holds", () => {
  for (const name of ["a/b", "50%", "a%2Fb", "x+y z", "../../etc", "#?&=\"<i>", "ü"])
    expect(takeName(takeAddress(name).split("?")[0] as string)).toBe(name);
  expect([takeName("/take"), takeName("/take/"), takeName("/"), takeName("/take/50%")]).toEqual([null, null, null, "50%"]);
});
