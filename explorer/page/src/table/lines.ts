// The rows of a table that are in the page. They are plain elements, not React's: a frame of a scroll changes the texts
// of the rows that come into sight and nothing else. What costs most there is not script but style, layout and paint, so
//  - rows that leave sight lend their elements to those that come;
//  - a row is put into place by `top`: a transform is a layer's worth of bookkeeping for each;
//  - a cell clips its text only where it may be too long: every clip is a step of its own in paint and layers.

import type { Cell, RowSource } from "./blocks";

export interface GridColumn<Row> {
  key: string;
  title: string;
  /** What the pointer shows on the title. */
  about?: string;
  /** Width in pixels; the first column of texts takes what is left. */
  width: number;
  numeric?: boolean;
  sortable?: boolean;
  /** Class of the cells, not of the title. */
  className?: string;
  cell: (row: Row, index: number) => Cell;
}

export const ROW = 26;
const PADDING = 16;
/** Rows that are there above and below those in sight. */
const BEYOND = 4;
/** The elements are put into the order of their rows, for screen readers, once the table has been still for so long. */
const STILL_MS = 150;

/** The columns as they are laid out in every row. */
export function template(columns: readonly { width: number; numeric?: boolean }[]): string {
  const wide = Math.max(0, columns.findIndex(({ numeric }) => numeric !== true));
  return columns.map(({ width }, place) => (place === wide ? `minmax(${width}px, 1fr)` : `${width}px`)).join(" ");
}

/** Return whether a text is surely narrower than a width: a sum of the widths of characters, with room for kerning. */
export function fits(text: string, width: number, widths: ArrayLike<number>): boolean {
  let sum = 0;
  const most = width / 1.03;
  for (let i = 0; i < text.length; i++) {
    sum += widths[text.charCodeAt(i)] ?? Infinity; // what is not ASCII may be of any width
    if (sum > most) return false;
  }
  return true;
}

/** Return the widths of the characters of ASCII in the font of an element, digits as wide as the widest. */
function characterWidths(element: Element): Float32Array {
  const pen = document.createElement("canvas").getContext("2d") as CanvasRenderingContext2D;
  pen.font = getComputedStyle(element).font;
  const widths = Float32Array.from({ length: 127 }, (_, code) => pen.measureText(String.fromCharCode(code)).width);
  const digit = Math.max(...widths.subarray(48, 58));
  widths.fill(digit, 48, 58);
  return widths;
}

interface Line {
  readonly element: HTMLDivElement;
  readonly cells: HTMLDivElement[];
  index: number;
  data: unknown;
  heading: boolean;
}

const NOWHERE = -1;
const NOTHING = {};

export class Lines<Row> {
  private lines: Line[] = [];
  private active: readonly [number, number] = [NOWHERE, NOWHERE];
  private readonly widths: Float32Array;
  private readonly laid: string;
  private first = 0;
  private stop = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  height = 0;
  /** Called with what the pointer would show on the active cell, whenever that is another text. */
  onNote: (text: string) => void = () => {};
  private note = "";

  constructor(
    private readonly body: HTMLElement,
    private readonly scroller: HTMLElement,
    /** Shows the heading of the first row in sight. */
    private readonly stuck: HTMLElement,
    private readonly columns: readonly GridColumn<Row>[],
    private readonly source: RowSource<Row>,
    private readonly activeId: string,
  ) {
    this.laid = template(columns);
    this.widths = characterWidths(scroller);
  }

  /** Put the rows in sight into the page. */
  draw = (): void => {
    const { source, scroller } = this;
    const top = scroller.scrollTop;
    const first = Math.max(0, Math.min(source.count, Math.floor(top / ROW)) - BEYOND);
    const stop = Math.min(source.count, Math.ceil((top + this.height) / ROW) + BEYOND);
    if (first !== this.first || stop !== this.stop) this.orderSoon();
    this.first = first;
    this.stop = stop;
    source.look?.(first, stop);
    this.stick(top);
    this.provide(Math.ceil(this.height / ROW) + 2 * BEYOND + 1);
    for (let index = first; index < stop; index++) this.place(this.lineOf(index), index);
  };

  /** Keep the heading of the first row in sight at the top, unless it stands there itself. */
  private stick(top: number): void {
    const { source } = this;
    const index = Math.min(source.count - 1, Math.floor(top / ROW));
    const isThere = index < 0 || (top <= index * ROW && source.heading?.(index) !== undefined);
    const content = isThere ? undefined : source.headingAbove?.(index);
    const text = typeof content === "object" ? content.text : (content ?? "");
    if (this.stuck.textContent !== text) this.stuck.textContent = text;
    this.stuck.hidden = text === "";
  }

  /** Mark a cell as the active one; row −1 for none. */
  setActive(index: number, place: number): void {
    const [before] = this.active;
    this.active = [index, place];
    for (const one of new Set([before, index])) {
      const line = one >= this.first && one < this.stop ? this.lineOf(one) : undefined;
      if (line?.index === one) this.mark(line);
    }
    this.tellNote();
  }

  /** Report the remark of the active cell, or its text where that is cut off; out of sight it stays as it was. */
  private tellNote(): void {
    const [index, place] = this.active;
    const line = index >= this.first && index < this.stop ? this.lineOf(index) : undefined;
    if (index >= 0 && line?.index !== index) return;
    const text = line?.cells[line.heading ? 0 : place]?.title ?? "";
    if (text === this.note) return;
    this.note = text;
    this.onNote(text);
  }

  end(): void {
    clearTimeout(this.timer);
    this.body.replaceChildren();
  }

  private lineOf(index: number): Line {
    return this.lines[index % this.lines.length] as Line;
  }

  /** Make more elements where the table has become higher. */
  private provide(count: number): void {
    if (count <= this.lines.length) return;
    for (const line of this.lines) line.index = NOWHERE;
    while (this.lines.length < count) this.lines.push(this.newLine());
  }

  private newLine(): Line {
    const element = document.createElement("div");
    element.setAttribute("role", "row");
    element.className = "grid-row grid-body";
    element.style.gridTemplateColumns = this.laid;
    const cells = this.columns.map((column, place) => {
      const cell = document.createElement("div");
      cell.setAttribute("role", "gridcell");
      cell.setAttribute("aria-colindex", String(place + 1));
      cell.className = column.className === undefined ? cellClass(column) : `${cellClass(column)} ${column.className}`;
      cell.append("");
      element.append(cell);
      return cell;
    });
    return { element, cells, index: NOWHERE, data: NOTHING, heading: false };
  }

  private place(line: Line, index: number): void {
    const heading = this.source.heading?.(index);
    const data = heading ?? this.source.row(index);
    if (line.index === index && line.data === data) return;
    const { element } = line;
    if (line.index !== index) {
      line.index = index;
      element.dataset.row = String(index);
      element.setAttribute("aria-rowindex", String(index + 2));
      element.style.top = `${index * ROW}px`;
      this.mark(line);
      if (!element.isConnected) this.body.append(element);
    }
    element.classList.toggle("loading", data === undefined);
    line.data = data;
    this.turn(line, heading !== undefined);
    this.columns.forEach((column, place) => {
      const cell = line.cells[place] as HTMLElement;
      if (heading !== undefined) this.write(cell, column, place === 0 ? heading : "");
      else this.write(cell, column, data === undefined ? "…" : column.cell(data as Row, index));
    });
    if (index === this.active[0]) this.tellNote();
  }

  /** Make a row a heading, whose first cell spans all, or a row of data again. */
  private turn(line: Line, heading: boolean): void {
    if (line.heading === heading) return;
    line.heading = heading;
    line.element.classList.toggle("grid-heading", heading);
    const [first] = line.cells;
    first?.setAttribute("role", heading ? "rowheader" : "gridcell");
    if (heading) first?.setAttribute("aria-colspan", String(line.cells.length));
    else first?.removeAttribute("aria-colspan");
  }

  private write(cell: HTMLElement, column: GridColumn<Row>, content: Cell): void {
    const { text, href, note } = typeof content === "string" ? { text: content, href: undefined, note: undefined } : content;
    const link = cell.firstElementChild;
    if (href !== undefined) (link ?? newLink(cell)).setAttribute("href", href);
    else if (link !== null) cell.replaceChildren("");
    const node = (cell.firstElementChild ?? cell).firstChild as Text;
    if (node.data !== text) node.data = text;
    const long = !fits(text, column.width - PADDING, this.widths);
    cell.classList.toggle("long", long);
    const title = note ?? (long ? text : undefined);
    if (title !== undefined) cell.title = title;
    else if (cell.hasAttribute("title")) cell.removeAttribute("title");
  }

  /** Give a row, and its active cell if it has it, their marks. */
  private mark(line: Line): void {
    const place = line.index === this.active[0] ? this.active[1] : NOWHERE;
    if (place < 0 && !line.element.classList.contains("active")) return;
    line.element.classList.toggle("active", place >= 0);
    line.cells.forEach((cell, i) => {
      cell.classList.toggle("active", i === place);
      if (i === place) cell.id = this.activeId;
      else if (cell.id !== "") cell.removeAttribute("id");
    });
  }

  private orderSoon(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(this.order, STILL_MS);
  }

  /** Give the elements the order of their rows, and drop those that hold none. */
  private readonly order = (): void => {
    let at = this.body.firstElementChild;
    for (let index = this.first; index < this.stop; index++) {
      const { element } = this.lineOf(index);
      if (element === at) at = at.nextElementSibling;
      else this.body.insertBefore(element, at);
    }
    while (at !== null) {
      const next: Element | null = at.nextElementSibling;
      at.remove();
      at = next;
    }
    for (const line of this.lines) if (!line.element.isConnected) line.index = NOWHERE;
  };
}

export function cellClass(column: { numeric?: boolean }): string {
  return column.numeric === true ? "grid-cell number" : "grid-cell";
}

function newLink(cell: HTMLElement): HTMLAnchorElement {
  const link = document.createElement("a");
  link.tabIndex = -1;
  link.append("");
  cell.replaceChildren(link);
  return link;
}
