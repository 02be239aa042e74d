// A table of any number of rows: only those in sight are in the page. It is an ARIA grid with one stop for Tab; arrows,
// Page Up and Down, Home and End move the active cell, Enter opens a row or sorts by a column.

import "./grid.css";

import { type KeyboardEvent, type MouseEvent, useEffect, useId, useLayoutEffect, useMemo, useRef, useState } from "react";
import { useLocation } from "wouter";

import type { RowSource } from "./blocks";
import { cellClass, type GridColumn, Lines, ROW, template } from "./lines";

export interface GridSort {
  column: string;
  descending: boolean;
}

interface Props<Row> {
  label: string;
  columns: readonly GridColumn<Row>[];
  /** The rows; the same object as long as they are the same. */
  rows: RowSource<Row>;
  sort?: GridSort | null;
  onSort?: (column: string) => void;
  onOpen?: (row: Row, index: number) => void;
  /** Called for a heading of `rows` as `onOpen` is for a row. */
  onHeading?: (index: number) => void;
}

const HEADER = -1;

export function VirtualGrid<Row>(props: Props<Row>) {
  const { label, columns, rows, sort, onSort, onOpen, onHeading } = props;
  const id = useId();
  const [active, setActive] = useState<readonly [number, number]>([HEADER, 0]);
  const [at, column] = [Math.min(active[0], rows.count - 1), Math.min(active[1], columns.length - 1)];
  const { scroller, body, stuck, note } = useLines(columns, rows, `${id}-active`, at, column);
  const laid = useMemo(() => template(columns), [columns]);
  const width = useMemo(() => columns.reduce((sum, one) => sum + one.width, 0), [columns]);

  const [, navigate] = useLocation();
  // One listener for all cells: a row has none of its own.
  const onClick = (event: MouseEvent) => {
    const [index, place] = placeOf(event.target);
    if (place < 0) return;
    setActive([index, place]);
    const title = columns[place];
    if (index === HEADER && title?.sortable === true) onSort?.(title.key);
    const link = (event.target as Element).closest("a");
    if (link !== null && link.origin === window.location.origin && !isModified(event)) {
      event.preventDefault();
      navigate(link.pathname + link.search);
    }
  };
  const open = (index: number) => {
    const data = index >= 0 ? rows.row(index) : undefined;
    if (data !== undefined) onOpen?.(data, index);
    else if (index >= 0 && rows.heading?.(index) !== undefined) onHeading?.(index);
  };
  const move = (index: number, place: number) => {
    const next = Math.max(HEADER, Math.min(rows.count - 1, index));
    setActive([next, Math.max(0, Math.min(columns.length - 1, place))]);
    if (next >= 0 && scroller.current !== null)
      bringIntoSight(scroller.current, next, rows.heading !== undefined && rows.heading(next) === undefined);
  };
  const onKey = (event: KeyboardEvent) => {
    const page = Math.max(1, Math.floor((scroller.current?.clientHeight ?? 0) / ROW) - 2);
    const whole = event.ctrlKey || event.metaKey;
    const steps: Record<string, () => void> = {
      ArrowDown: () => move(at + 1, column),
      ArrowUp: () => move(at - 1, column),
      ArrowRight: () => move(at, column + 1),
      ArrowLeft: () => move(at, column - 1),
      PageDown: () => move(at + page, column),
      PageUp: () => move(Math.max(0, at - page), column),
      Home: () => move(whole ? 0 : at, whole ? column : 0),
      End: () => move(whole ? rows.count - 1 : at, whole ? column : columns.length - 1),
      Enter: () => {
        if (at >= 0) open(at);
        else if (columns[column]?.sortable === true) onSort?.(columns[column].key);
      },
    };
    const step = event.altKey ? undefined : steps[event.key];
    if (step !== undefined) {
      event.preventDefault();
      step();
    }
  };
  const remark = at === HEADER ? (columns[column]?.about ?? "") : note;
  useLayoutEffect(() => {
    // the remark takes room below the rows
    if (remark !== "" && at >= 0 && scroller.current !== null) bringIntoSight(scroller.current, at, false);
  }, [remark]);
  return (
    <div className="grid-frame">
      <div
        ref={scroller}
        className="grid"
        role="grid"
        aria-label={label}
        aria-rowcount={rows.count + 1}
        aria-colcount={columns.length}
        aria-activedescendant={`${id}-active`}
        tabIndex={0}
        onKeyDown={onKey}
        onClick={onClick}
        onMouseDown={(event) => event.detail > 1 && event.preventDefault()} // a double click opens, and selects no text
        onDoubleClick={(event) => open(placeOf(event.target)[0])}
      >
        <div role="rowgroup" className="grid-head" style={{ minWidth: width }}>
          <div role="row" data-row={HEADER} aria-rowindex={1} className="grid-row" style={{ gridTemplateColumns: laid }}>
            {columns.map((one, place) => (
              <div
                key={one.key}
                id={at === HEADER && place === column ? `${id}-active` : undefined}
                role="columnheader"
                aria-colindex={place + 1}
                aria-sort={sorted(one.key, sort)}
                className={`${cellClass(one)} long${at === HEADER && place === column ? " active" : ""}`}
                data-sortable={one.sortable}
                title={one.about}
              >
                {one.title}
                {sort?.column === one.key && <span aria-hidden> {sort.descending ? "▾" : "▴"}</span>}
              </div>
            ))}
          </div>
          <div ref={stuck} className="grid-stuck" aria-hidden hidden />
        </div>
        <div ref={body} role="rowgroup" className="grid-rows" style={{ height: (rows.count + 1) * ROW, minWidth: width }} />
      </div>
      {remark !== "" && (
        <div className="grid-note" role="note" tabIndex={0} aria-label="The active cell in full">
          {remark}
        </div>
      )}
    </div>
  );
}

/** Keep the rows in sight in the page, whenever somebody scrolls, rows arrive, or the table changes its size. */
function useLines<Row>(
  columns: readonly GridColumn<Row>[],
  rows: RowSource<Row>,
  activeId: string,
  at: number,
  column: number,
) {
  const scroller = useRef<HTMLDivElement>(null);
  const body = useRef<HTMLDivElement>(null);
  const stuck = useRef<HTMLDivElement>(null);
  const lines = useRef<Lines<Row>>(null);
  const [note, setNote] = useState("");
  useLayoutEffect(() => {
    const [outer, inner, top] = [scroller.current, body.current, stuck.current];
    if (outer === null || inner === null || top === null) return;
    const made = new Lines(inner, outer, top, columns, rows, activeId);
    lines.current = made;
    made.height = outer.clientHeight;
    made.onNote = setNote;
    setNote("");
    made.draw();
    const watch = new ResizeObserver(() => {
      made.height = outer.clientHeight;
      made.draw();
    });
    watch.observe(outer);
    outer.addEventListener("scroll", made.draw, { passive: true });
    const end = rows.subscribe?.(made.draw);
    return () => {
      watch.disconnect();
      outer.removeEventListener("scroll", made.draw);
      end?.();
      made.end();
    };
  }, [columns, rows, activeId]);
  useEffect(() => lines.current?.setActive(at, column), [columns, rows, activeId, at, column]);
  return { scroller, body, stuck, note };
}

/** Scroll as little as needed for a whole row to be in sight, below the titles and the heading that stays there. */
function bringIntoSight(scroller: HTMLElement, index: number, headed: boolean): void {
  const top = Math.max(0, index - (headed ? 1 : 0)) * ROW;
  const low = index * ROW + 2 * ROW - scroller.clientHeight + 2;
  if (scroller.scrollTop > top) scroller.scrollTop = top;
  else if (scroller.scrollTop < low) scroller.scrollTop = low;
}

function sorted(key: string, sort: GridSort | null | undefined): "ascending" | "descending" | "none" {
  if (sort?.column !== key) return "none";
  return sort.descending ? "descending" : "ascending";
}

function isModified(event: MouseEvent): boolean {
  return event.ctrlKey || event.metaKey || event.shiftKey || event.altKey || event.button !== 0;
}

/** Return the row and the column of the cell that an event is on; column -1 where it is on none. */
function placeOf(target: EventTarget): [number, number] {
  const cell = (target as Element).closest<HTMLElement>(".grid-cell");
  const line = cell?.parentElement;
  if (cell === null || line == null) return [HEADER, -1];
  return [Number(line.dataset.row), [...line.children].indexOf(cell)];
}
