// A table of any number of rows: only those in sight are in the page. It is an ARIA grid with one stop for Tab; arrows,
// Page Up and Down, Home and End move the active cell, Enter opens a row or sorts by a column.

import "./grid.css";

import { useVirtualizer } from "@tanstack/react-virtual";
import { type KeyboardEvent, memo, type MouseEvent, type ReactNode, useEffect, useId, useMemo, useRef, useState } from "react";
import { useLocation } from "wouter";

export interface GridColumn<Row> {
  key: string;
  title: string;
  /** Width in pixels; the first column takes what is left. */
  width: number;
  numeric?: boolean;
  sortable?: boolean;
  cell: (row: Row, index: number) => ReactNode;
}

export interface GridSort {
  column: string;
  descending: boolean;
}

interface Props<Row> {
  label: string;
  columns: readonly GridColumn<Row>[];
  rowCount: number;
  /** Return a row, or undefined while it is being loaded. */
  row: (index: number) => Row | undefined;
  sort?: GridSort | null;
  onSort?: (column: string) => void;
  onOpen?: (row: Row, index: number) => void;
  /** Report the rows in sight: first, and the one after the last. */
  onRange?: (first: number, stop: number) => void;
}

const ROW = 26;
const HEADER = -1;

export function VirtualGrid<Row>(props: Props<Row>) {
  const { label, columns, rowCount, row, sort, onSort, onOpen, onRange } = props;
  const id = useId();
  const scroller = useRef<HTMLDivElement>(null);
  const [active, setActive] = useState<[number, number]>([HEADER, 0]);
  const virtual = useVirtualizer({
    count: rowCount,
    getScrollElement: () => scroller.current,
    estimateSize: () => ROW,
    overscan: 5,
    paddingEnd: ROW,
  });
  const items = virtual.getVirtualItems();
  const first = items[0]?.index ?? 0;
  const stop = (items[items.length - 1]?.index ?? -1) + 1;
  useEffect(() => onRange?.(first, stop), [onRange, first, stop]);

  const template = useMemo(
    () => columns.map((one, place) => (place === 0 ? `minmax(${one.width}px, 1fr)` : `${one.width}px`)).join(" "),
    [columns],
  );
  const width = useMemo(() => columns.reduce((sum, one) => sum + one.width, 0), [columns]);
  const [at, column] = [Math.min(active[0], rowCount - 1), Math.min(active[1], columns.length - 1)];

  // Rows that leave sight lend their elements to those that come: to change texts is quicker than to make elements.
  const pool = useRef(1);
  pool.current = Math.max(pool.current, items.length);

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
  const onDoubleClick = (event: MouseEvent) => {
    const [index] = placeOf(event.target);
    const data = index >= 0 ? row(index) : undefined;
    if (data !== undefined) onOpen?.(data, index);
  };
  const move = (index: number, place: number) => {
    const next = Math.max(HEADER, Math.min(rowCount - 1, index));
    setActive([next, Math.max(0, Math.min(columns.length - 1, place))]);
    if (next >= 0) virtual.scrollToIndex(next, { align: "auto" });
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
      End: () => move(whole ? rowCount - 1 : at, whole ? column : columns.length - 1),
      Enter: () => {
        const data = at >= 0 ? row(at) : undefined;
        if (data !== undefined) onOpen?.(data, at);
        else if (at === HEADER && columns[column]?.sortable === true) onSort?.(columns[column].key);
      },
    };
    const step = event.altKey ? undefined : steps[event.key];
    if (step !== undefined) {
      event.preventDefault();
      step();
    }
  };
  return (
    <div
      ref={scroller}
      className="grid"
      role="grid"
      aria-label={label}
      aria-rowcount={rowCount + 1}
      aria-colcount={columns.length}
      aria-activedescendant={`${id}-active`}
      tabIndex={0}
      onKeyDown={onKey}
      onClick={onClick}
      onDoubleClick={onDoubleClick}
      onMouseOver={showWhole}
    >
      <div role="rowgroup" className="grid-head" style={{ minWidth: width }}>
        <div role="row" data-row={HEADER} aria-rowindex={1} className="grid-row" style={{ gridTemplateColumns: template }}>
          {columns.map((one, place) => (
            <div
              key={one.key}
              id={at === HEADER && place === column ? `${id}-active` : undefined}
              role="columnheader"
              aria-colindex={place + 1}
              aria-sort={sorted(one.key, sort)}
              className={cellClass(one, at === HEADER && place === column)}
              data-sortable={one.sortable}
            >
              {one.title}
              {sort?.column === one.key && <span aria-hidden> {sort.descending ? "▾" : "▴"}</span>}
            </div>
          ))}
        </div>
      </div>
      <div role="rowgroup" style={{ height: virtual.getTotalSize(), position: "relative", minWidth: width }}>
        {items.map((item) => (
          <GridRow
            key={item.index % pool.current}
            id={id}
            index={item.index}
            top={item.start}
            template={template}
            columns={columns as readonly GridColumn<unknown>[]}
            data={row(item.index)}
            active={item.index === at ? column : -1}
          />
        ))}
      </div>
    </div>
  );
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

/** Show the whole text of a cell that is cut off, once the pointer is on it. */
function showWhole(event: MouseEvent): void {
  const cell = (event.target as Element).closest<HTMLElement>(".grid-cell");
  if (cell === null || cell.querySelector("[title]") !== null) return;
  if (cell.scrollWidth > cell.clientWidth) cell.title = cell.textContent ?? "";
  else cell.removeAttribute("title");
}

function cellClass(column: { numeric?: boolean }, active: boolean): string {
  return `grid-cell${column.numeric === true ? " number" : ""}${active ? " active" : ""}`;
}

interface RowProps {
  id: string;
  index: number;
  top: number;
  template: string;
  columns: readonly GridColumn<unknown>[];
  data: unknown;
  active: number;
}

const GridRow = memo(function GridRow({ id, index, top, template, columns, data, active }: RowProps) {
  return (
    <div
      role="row"
      data-row={index}
      aria-rowindex={index + 2}
      className={active >= 0 ? "grid-row grid-body active" : "grid-row grid-body"}
      style={{ gridTemplateColumns: template, transform: `translateY(${top}px)` }}
    >
      {columns.map((one, place) => (
        <div
          key={one.key}
          id={place === active ? `${id}-active` : undefined}
          role="gridcell"
          aria-colindex={place + 1}
          className={cellClass(one, place === active)}
        >
          {data === undefined ? <span className="muted">…</span> : one.cell(data, index)}
        </div>
      ))}
    </div>
  );
});
