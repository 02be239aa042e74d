import { expect, test } from "vitest";

import { listed } from "./blocks";
import { Grouped } from "./grouped";

test("headings stand before the rows of their groups, and rows in sight are those asked for", () => {
  for (const sizes of [[1], [3, 0, 2], [2, 5, 1, 1], []]) {
    const total = sizes.reduce((sum, one) => sum + one, 0);
    const rows = listed(Array.from({ length: total }, (_, i) => `row ${i}`));
    // the table written out
    const twin: { heading?: string; row?: string; group: number }[] = [];
    let next = 0;
    sizes.forEach((size, group) => {
      twin.push({ heading: `group ${group}`, group });
      for (let i = 0; i < size; i++) twin.push({ row: `row ${next++}`, group });
    });
    const looked: [number, number][] = [];
    const source = { ...rows, look: (first: number, stop: number) => void looked.push([first, stop]) };
    const grouped = new Grouped(source, sizes.map((size, i) => ({ rows: size, heading: `group ${i}` })));
    expect(grouped.count).toBe(twin.length);
    twin.forEach((one, index) => {
      expect(grouped.row(index)).toBe(one.row);
      expect(grouped.heading(index)).toBe(one.heading);
      expect(grouped.headingAbove(index)).toBe(`group ${one.group}`);
    });
    for (let first = 0; first < twin.length; first++)
      for (let stop = first + 1; stop <= twin.length; stop++) {
        grouped.look(first, stop);
        const [from, to] = looked.pop() as [number, number];
        for (const { row } of twin.slice(first, stop)) {
          if (row === undefined) continue;
          const place = Number(row.slice(4));
          expect(place >= from && place < to).toBe(true);
        }
        expect(to - from).toBeLessThanOrEqual(stop - first);
      }
  }
});
