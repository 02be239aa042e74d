// Rows in groups, each below a heading: a heading is a row of the table that has no data of its own.

import type { Cell, RowSource } from "./blocks";

export interface RowGroup {
  rows: number;
  heading: Cell;
}

export class Grouped<Row> implements RowSource<Row> {
  readonly count: number;
  /** The rows of the table that are headings. */
  private readonly starts: readonly number[];

  /** The groups follow each other as the rows do, and hold all of them. */
  constructor(
    private readonly source: RowSource<Row>,
    private readonly groups: readonly RowGroup[],
  ) {
    let next = 0;
    this.starts = groups.map((group) => {
      const start = next;
      next += group.rows + 1;
      return start;
    });
    this.count = next;
  }

  /** Return the place of the group that a row of the table belongs to. */
  groupAt(index: number): number {
    let [low, high] = [0, this.starts.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if ((this.starts[middle] as number) <= index) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  row = (index: number): Row | undefined => {
    const group = this.groupAt(index);
    return this.starts[group] === index ? undefined : this.source.row(index - group - 1);
  };

  heading = (index: number): Cell | undefined => {
    const group = this.groupAt(index);
    return this.starts[group] === index ? this.groups[group]?.heading : undefined;
  };

  headingAbove = (index: number): Cell | undefined => this.groups[this.groupAt(index)]?.heading;

  look = (first: number, stop: number): void => {
    const before = (index: number) => Math.max(0, index - this.groupAt(Math.max(0, index - 1)) - 1);
    const from = before(first);
    this.source.look?.(from, Math.max(from + 1, before(stop)));
  };

  subscribe = (listener: () => void): (() => void) => this.source.subscribe?.(listener) ?? (() => {});
}
