// Rows that are loaded block by block while they are in sight. Nothing here is React's: a table that scrolls through
// hundreds of blocks a second must not render a page for each.

import { type QueryClient, QueriesObserver, type QueryKey } from "@tanstack/react-query";
import { useSyncExternalStore } from "react";

/** The content of a cell: a text, or a text that leads somewhere or has a remark for the pointer. */
export type Cell = string | { text: string; href?: string; note?: string };

/** What a table shows. */
export interface RowSource<Row> {
  readonly count: number;
  /** Return a row, or undefined while it is being loaded. */
  row(index: number): Row | undefined;
  /** Return the heading that a row is, undefined where it is none. */
  heading?(index: number): Cell | undefined;
  /** Return the heading of the group that a row belongs to. */
  headingAbove?(index: number): Cell | undefined;
  /** Take note of the rows in sight: first, and the one after the last. */
  look?(first: number, stop: number): void;
  /** Call a function when rows have arrived or changed; returns a function that ends that. */
  subscribe?(listener: () => void): () => void;
}

/** Rows that are all there. */
export function listed<Row>(rows: readonly Row[]): RowSource<Row> {
  return { count: rows.length, row: (index) => rows[index] };
}

/** Blocks are asked for once the table has been still for so long, so that a long scroll asks for few. */
const STILL_MS = 60;

interface BlockQuery<Block> {
  queryKey: QueryKey;
  queryFn: (context: { signal: AbortSignal }) => Promise<Block>;
}

/** Blocks of rows of one question. They are asked for anew when the version of the store changes. */
export class Blocks<Block extends object, Row> implements RowSource<Row> {
  private readonly listeners = new Set<() => void>();
  private readonly made = new WeakMap<Block, readonly Row[]>();
  private readonly loaded = new Map<number, Block>();
  private readonly observer: QueriesObserver;
  private range: readonly [number, number] = [0, 0];
  private watched: readonly number[] = [];
  private timer: ReturnType<typeof setTimeout> | undefined;
  private end: (() => void) | null = null;
  private changes = 0;

  constructor(
    private readonly client: QueryClient,
    readonly count: number,
    private readonly size: number,
    private readonly query: (block: number) => BlockQuery<Block>,
    private readonly rowsOf: (block: Block) => readonly Row[],
  ) {
    this.observer = new QueriesObserver(client, []);
  }

  row = (index: number): Row | undefined => {
    const block = this.loaded.get(Math.floor(index / this.size));
    if (block === undefined) return undefined;
    let rows = this.made.get(block);
    if (rows === undefined) this.made.set(block, (rows = this.rowsOf(block)));
    return rows[index % this.size];
  };

  look = (first: number, stop: number): void => {
    const from = Math.floor(first / this.size);
    const to = Math.max(from + 1, Math.ceil(stop / this.size));
    if (from === this.range[0] && to === this.range[1]) return;
    const isFirst = this.range[1] === 0;
    this.range = [from, to];
    for (const block of this.loaded.keys()) if (block < from || block >= to) this.loaded.delete(block);
    for (let block = from; block < to; block++) {
      const known = this.loaded.has(block) ? undefined : this.client.getQueryData<Block>(this.query(block).queryKey);
      if (known !== undefined) this.loaded.set(block, known);
    }
    clearTimeout(this.timer);
    if (isFirst) this.load();
    else this.timer = setTimeout(this.load, STILL_MS);
  };

  /** Ask for what is in sight, and keep it up to date from now on. */
  private readonly load = (): void => {
    const [from, to] = this.range;
    this.watched = Array.from({ length: to - from }, (_, place) => from + place);
    this.observer.setQueries(this.watched.map((block) => this.query(block)));
    this.take();
  };

  private readonly take = (): void => {
    let changed = false;
    this.observer.getCurrentResult().forEach((result, place) => {
      const block = this.watched[place] as number;
      const data = result.data as Block | undefined;
      if (data === undefined || block < this.range[0] || block >= this.range[1] || this.loaded.get(block) === data) return;
      this.loaded.set(block, data);
      changed = true;
    });
    if (!changed) return;
    this.changes++;
    for (const listener of this.listeners) listener();
  };

  subscribe = (listener: () => void): (() => void) => {
    this.listeners.add(listener);
    this.end ??= this.observer.subscribe(this.take);
    return () => {
      this.listeners.delete(listener);
      if (this.listeners.size > 0) return;
      clearTimeout(this.timer);
      this.end?.();
      this.end = null;
    };
  };

  /** A number that changes whenever rows do. */
  version = (): number => this.changes;
}

/** Render a component anew whenever rows arrive. */
export function useArrivals<Block extends object, Row>(blocks: Blocks<Block, Row>): void {
  useSyncExternalStore(blocks.subscribe, blocks.version);
}
