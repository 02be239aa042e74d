// Takes as small moving figures: a grid of which only the lines in sight are in the page. It has one stop for Tab;
// arrows, Page Up and Down, Home and End move from take to take, Enter opens one.

import "./wall.css";

import { useElementSize, useMergedRef } from "@mantine/hooks";
import { defaultRangeExtractor, type Range, useVirtualizer } from "@tanstack/react-virtual";
import { type CSSProperties, type KeyboardEvent, memo, type MouseEvent, useEffect, useId, useMemo, useRef, useState } from "react";
import { useLocation } from "wouter";

import { takeAddress, useParameter, useParameters } from "../app/address";
import { useShortcuts } from "../app/shortcuts";
import { SmallFigure } from "../motion/SmallFigure";
import type { TakeRow } from "./questions";
import { counted, hours, named } from "./text";
import { lineOf, shownFrames, takeBelow, takeOfGroup, type WallGroup, type WallLine, wallLines } from "./wall";

/** Width and height of the figures, and lines of the names. */
const SIZES = { small: [72, 84, 3], medium: [104, 116, 2], large: [160, 180, 2] } as const;
export type WallSize = keyof typeof SIZES;
export const WALL_SIZES = Object.keys(SIZES) as WallSize[];
export const isWallSize = (text: string | null): text is WallSize => text !== null && text in SIZES;

const TEXT_LINE = 15;
const CAPTION_PADDING = 4;
const GAP = 6;
const BORDER = 2;
const HEADING = 30;
/** A figure is asked for once its place has been in sight for so long, so that a long scroll asks for few. */
const STILL_MS = 120;
const ADDRESS_MS = 300;

interface Props {
  groups: readonly WallGroup[];
  /** The column of the groups, null where there is one group only. */
  by: string | null;
  rateHz: number;
  size: WallSize;
  /** True if only the figure of the active take moves. */
  still: boolean;
  row: (index: number) => TakeRow | undefined;
  onRange: (first: number, stop: number) => void;
  /** Show the takes of one group alone. */
  onKeep: (group: number) => void;
  /** Let the figures rest, or move again. */
  onStill: () => void;
}

export function WallGrid({ groups, by, rateHz, size, still, row, onRange, onKeep, onStill }: Props) {
  const id = useId();
  const scroller = useRef<HTMLDivElement>(null);
  const measured = useElementSize();
  const both = useMergedRef(scroller, measured.ref);
  const [width, height, names] = SIZES[size];
  const full = height + names * TEXT_LINE + CAPTION_PADDING + BORDER;
  const across = Math.max(1, Math.floor((measured.width - GAP) / (width + BORDER + GAP)));
  const lines = useMemo(() => wallLines(groups, across, by !== null), [groups, across, by]);
  const total = useMemo(() => groups.reduce((sum, one) => sum + one.takes, 0), [groups]);
  const [active, setActive] = useActive(total);
  const sticky = useRef(-1);
  const virtual = useVirtualizer({
    count: lines.length,
    getScrollElement: () => scroller.current,
    estimateSize: (place) => (lines[place]?.kind === "heading" ? HEADING : full + GAP),
    overscan: 1,
    scrollPaddingStart: by === null ? 0 : HEADING,
    rangeExtractor: (range) => withHeading(range, lines, sticky),
  });
  useEffect(() => virtual.measure(), [virtual, lines, height]);
  const items = virtual.getVirtualItems();
  const columns: CSSProperties = { gridTemplateColumns: `repeat(${across}, minmax(0, 1fr))` };
  const rows = items.flatMap((item) => {
    const line = lines[item.index];
    return line?.kind === "row" ? [line] : [];
  });
  const [first, stop] = [rows[0]?.first ?? 0, rows[rows.length - 1]?.stop ?? 1];
  useEffect(() => onRange(first, stop), [onRange, first, stop]);
  // The take of the address comes into sight once the width is known.
  const placed = measured.width > 0;
  useEffect(() => {
    if (placed && active > 0) virtual.scrollToIndex(lineOf(lines, active), { align: "center" });
  }, [placed, by, size]);

  const [, navigate] = useLocation();
  const change = useParameters();
  const open = (take: number) => {
    const data = row(take);
    if (data === undefined) return;
    change({ at: String(take) }); // so that the way back leads here
    navigate(takeAddress(data.name));
  };
  const move = (take: number) => {
    const next = Math.max(0, Math.min(total - 1, take));
    setActive(next);
    virtual.scrollToIndex(lineOf(lines, next), { align: "auto" });
  };
  const keepGroup = (group: number) => {
    const before = groups.slice(0, group).reduce((sum, one) => sum + one.takes, 0);
    const inside = active >= before && active < before + (groups[group]?.takes ?? 0);
    setActive(inside ? active - before : 0);
    onKeep(group);
  };
  const line = lines[lineOf(lines, active)];
  useShortcuts("Wall", [
    { keys: "]", what: "Next group", run: () => move(takeOfGroup(groups, active, 1)) },
    { keys: "[", what: "Group before", run: () => move(takeOfGroup(groups, active, -1)) },
    {
      keys: "o",
      what: "Only the group of the chosen take",
      run: () => line !== undefined && by !== null && keepGroup(line.group),
    },
    { keys: "m", what: "Let the figures move or rest", run: onStill },
  ]);
  const onKey = (event: KeyboardEvent) => {
    const page = Math.max(1, Math.floor(((scroller.current?.clientHeight ?? 0) - HEADING) / (full + GAP)));
    const whole = event.ctrlKey || event.metaKey;
    const [left, right] = line?.kind === "row" ? [line.first, line.stop - 1] : [0, total - 1];
    const steps: Record<string, () => void> = {
      ArrowRight: () => move(active + 1),
      ArrowLeft: () => move(active - 1),
      ArrowDown: () => move(takeBelow(lines, active, 1)),
      ArrowUp: () => move(takeBelow(lines, active, -1)),
      PageDown: () => move(takeBelow(lines, active, page)),
      PageUp: () => move(takeBelow(lines, active, -page)),
      Home: () => move(whole ? 0 : left),
      End: () => move(whole ? total - 1 : right),
      Enter: () => open(active),
    };
    const step = event.altKey ? undefined : steps[event.key];
    if (step === undefined) return;
    event.preventDefault();
    step();
  };
  const onClick = (event: MouseEvent) => {
    const cell = (event.target as Element).closest<HTMLElement>("[data-take]");
    if (cell === null) return;
    const take = Number(cell.dataset.take);
    setActive(take);
    if (event.ctrlKey || event.metaKey || event.shiftKey || event.altKey) return; // the link opens another tab
    event.preventDefault();
    open(take);
  };
  return (
    <div
      ref={both}
      className="wall"
      data-size={size}
      role="grid"
      aria-label="Takes"
      aria-rowcount={lines.length}
      aria-colcount={across}
      aria-activedescendant={`${id}-active`}
      tabIndex={0}
      onKeyDown={onKey}
      onClick={onClick}
    >
      <div role="rowgroup" className="wall-lines" style={{ height: virtual.getTotalSize() }}>
        {items.map((item) => {
          const line = lines[item.index];
          if (line === undefined) return null;
          const stuck = item.index === sticky.current;
          return (
            <div
              key={item.key}
              role="row"
              aria-rowindex={item.index + 1}
              className={line.kind === "heading" ? "wall-heading" : "wall-row"}
              data-stuck={stuck}
              style={{ ...columns, ...(stuck ? {} : { transform: `translateY(${item.start}px)` }) }}
            >
              {line.kind === "heading" ? (
                <Heading group={groups[line.group]} by={by} place={line.group} across={across} onKeep={keepGroup} />
              ) : (
                Array.from({ length: line.stop - line.first }, (_, column) => {
                  const take = line.first + column;
                  return (
                    <Cell
                      key={take}
                      id={take === active ? `${id}-active` : undefined}
                      take={take}
                      column={column + 1}
                      data={row(take)}
                      rateHz={rateHz}
                      width={width}
                      height={height}
                      full={full}
                      active={take === active}
                      still={still}
                    />
                  );
                })
              )}
            </div>
          );
        })}
      </div>
    </div>
  );
}

/** The place of the active take, in the address once it has rested for a moment. */
function useActive(total: number): [number, (take: number) => void] {
  const [text, setText] = useParameter("at");
  const asked = Number(text ?? 0);
  const [active, setActive] = useState(Number.isInteger(asked) && asked > 0 ? asked : 0);
  useEffect(() => {
    const timer = setTimeout(() => setText(active === 0 ? null : String(active)), ADDRESS_MS);
    return () => clearTimeout(timer);
  }, [active]);
  return [Math.max(0, Math.min(active, total - 1)), setActive];
}

/** Return the lines of a range, and the heading of its first line, which stays at the top. */
function withHeading(range: Range, lines: readonly WallLine[], sticky: { current: number }): number[] {
  const places = defaultRangeExtractor(range);
  let place = Math.min(range.startIndex, lines.length - 1);
  while (place >= 0 && lines[place]?.kind !== "heading") place--;
  sticky.current = place;
  return place < 0 || places.includes(place) ? places : [place, ...places];
}

interface HeadingProps {
  group: WallGroup | undefined;
  by: string | null;
  place: number;
  across: number;
  onKeep: (group: number) => void;
}

function Heading({ group, by, place, across, onKeep }: HeadingProps) {
  if (group === undefined) return null;
  const rest = group.value === undefined;
  return (
    <div role="rowheader" aria-colspan={across} className="wall-heading-cell">
      <strong className={group.value === null ? "muted" : ""}>{rest ? "all further groups" : named(group.value)}</strong>
      <span className="muted">
        {counted(group.takes, "take")}, {hours(group.hours)}
      </span>
      {!rest && (
        <button
          type="button"
          tabIndex={-1}
          aria-label={`only these: ${by} ${named(group.value)}`}
          title="Show these takes only (o)"
          onClick={() => onKeep(place)}
        >
          only these
        </button>
      )}
    </div>
  );
}

interface CellProps {
  id: string | undefined;
  take: number;
  column: number;
  data: TakeRow | undefined;
  rateHz: number;
  width: number;
  height: number;
  /** Height with the caption. */
  full: number;
  active: boolean;
  still: boolean;
}

const Cell = memo(function Cell({ id, take, column, data, rateHz, width, height, full, active, still }: CellProps) {
  const [due, setDue] = useState(false);
  const [pointed, setPointed] = useState(false);
  useEffect(() => {
    const timer = setTimeout(() => setDue(true), STILL_MS);
    return () => clearTimeout(timer);
  }, []);
  const frames = Number(data?.values[1] ?? 0);
  const item = useMemo(() => {
    if (data === undefined || frames < 1) return null;
    const [start, stop] = shownFrames(frames, rateHz);
    return { take_id: data.id, start, stop };
  }, [data?.id, frames, rateHz]);
  const seconds = Number(data?.values[2] ?? 0).toFixed(1);
  return (
    <div
      id={id}
      role="gridcell"
      aria-colindex={column}
      aria-selected={active}
      className="wall-take"
      style={{ height: full }}
      data-take={take}
      onPointerEnter={() => setPointed(true)}
      onPointerLeave={() => setPointed(false)}
    >
      {data === undefined ? (
        <span className="muted">…</span>
      ) : (
        <a href={takeAddress(data.name)} tabIndex={-1} title={data.name} draggable={false}>
          <span className="wall-figure" style={{ height }}>
            {due && item !== null && (
              <SmallFigure item={item} width={width} height={height} moves={active || pointed || (still ? false : undefined)} />
            )}
          </span>
          <span className="wall-name">{data.name}</span>
          <span className="wall-seconds muted">{seconds} s</span>
        </a>
      )}
    </div>
  );
});
