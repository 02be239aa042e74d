// Pointers on the lanes: hover, click, brush, zoom and pan.

import { type PointerEvent as ReactPointerEvent, useCallback, useEffect, useRef } from "react";

import { frameAt, frameClock, pinched } from "./axis";
import { type Row, rowAt, segmentAt } from "./rows";
import type { Session } from "./session";
import type { Segment } from "./types";
import type { Words } from "./words";

const CLICK_PX = 4;

interface PointedLanes {
  session: Session;
  words: Words | null;
  onPick: (row: Row, segment: Segment | null, frame: number) => void;
}

/** Hover shows the pose, a click puts the playhead, a drag selects; a double click selects a segment. */
export function usePointer(
  props: PointedLanes,
  rows: readonly Row[],
  width: number,
  area: React.RefObject<HTMLDivElement | null>,
  tip: React.RefObject<HTMLDivElement | null>,
) {
  const { session, words, onPick } = props;
  const down = useRef<{ x: number; frame: number; brush: boolean } | null>(null);
  const pinch = usePinch(session, width);
  const place = useCallback(
    (event: { clientX: number; clientY: number }) => {
      const box = (area.current as HTMLDivElement).getBoundingClientRect();
      const x = event.clientX - box.left;
      const y = event.clientY - box.top;
      return { x, y, frame: frameAt(session.view, x, width), row: rowAt(rows, y) };
    },
    [area, rows, session, width],
  );
  const onPointerMove = (event: ReactPointerEvent) => {
    if (session.frames < 1) return;
    const { x, y, frame, row } = place(event);
    if (pinch.move(event.pointerId, x)) return;
    const held = down.current;
    if (held !== null && event.pointerType === "mouse") {
      if (Math.abs(x - held.x) > CLICK_PX) held.brush = true;
      if (held.brush) session.brush([held.frame, frame]);
    }
    if (!session.shown.playing) session.hover(Math.floor(frame));
    showTip(tip.current, x, y, width, describe(session, words, row, frame, y));
  };
  const onPointerLeave = () => {
    if (down.current === null) session.hover(null);
    if (tip.current !== null) tip.current.hidden = true;
  };
  const onPointerDown = (event: ReactPointerEvent) => {
    if (event.button !== 0) return;
    const { x, frame } = place(event);
    const pinched = event.pointerType === "touch" && pinch.down(event.pointerId, x);
    down.current = pinched ? null : { x, frame, brush: false };
    (event.currentTarget as HTMLElement).setPointerCapture(event.pointerId);
  };
  const onPointerUp = (event: ReactPointerEvent) => {
    pinch.up(event.pointerId);
    const held = down.current;
    down.current = null;
    if (held === null) return;
    const { x, y, frame, row } = place(event);
    session.hover(null);
    if (held.brush) session.select([held.frame, frame]);
    else {
      session.seek(Math.floor(frame));
      if (row !== null) onPick(row, row.kind === "segments" ? segmentAt(row, frame, y - row.y) : null, Math.floor(frame));
    }
    if (x < 0 || x > width) onPointerLeave();
  };
  const onPointerCancel = (event: ReactPointerEvent) => {
    pinch.up(event.pointerId);
    down.current = null;
    session.brush(null);
  };
  const onDoubleClick = (event: React.MouseEvent) => {
    const { frame, row, y } = place(event);
    if (row?.kind === "segments") {
      const segment = segmentAt(row, frame, y - row.y);
      if (segment !== null) session.select([segment.start, segment.stop]);
    } else if (row?.kind === "feature" && words !== null) {
      const run = words.runAt(row.bit, Math.min(words.frames - 1, Math.max(0, Math.floor(frame))));
      session.select([run.start, run.stop]);
    }
  };
  // where text is selected around the lanes, the browser would drag that text instead
  const onDragStart = (event: React.DragEvent) => event.preventDefault();
  return { onPointerMove, onPointerLeave, onPointerDown, onPointerUp, onPointerCancel, onDoubleClick, onDragStart };
}

/** Two fingers: what lies under them stays under them, so that the view zooms and pans. */
function usePinch(session: Session, width: number) {
  const fingers = useRef(new Map<number, number>());
  return {
    /** Take in a finger; true from the second on. */
    down: (id: number, x: number): boolean => {
      fingers.current.set(id, x);
      if (fingers.current.size > 1) session.hover(null);
      return fingers.current.size > 1;
    },
    /** Follow a finger; true while there are two. */
    move: (id: number, x: number): boolean => {
      const held = fingers.current;
      if (!held.has(id)) return false;
      const before = [...held.values()];
      held.set(id, x);
      if (held.size !== 2) return held.size > 2;
      session.setView(pinched(session.view, before as [number, number], [...held.values()] as [number, number], width));
      return true;
    },
    up: (id: number) => fingers.current.delete(id),
  };
}

function showTip(tip: HTMLDivElement | null, x: number, y: number, width: number, lines: readonly string[]): void {
  if (tip === null) return;
  tip.hidden = false;
  tip.textContent = lines.join("\n");
  const right = x > width * 0.65;
  tip.style.transform = `translate(${right ? `calc(${x - 12}px - 100%)` : `${x + 14}px`}, ${y + 14}px)`;
}

/** Return what lies under the pointer. */
function describe(session: Session, words: Words | null, row: Row | null, frame: number, y: number): string[] {
  const whole = Math.min(session.frames - 1, Math.max(0, Math.floor(frame)));
  const seconds = (one: number) => frameClock(one, session.rateHz);
  const lines = [`${seconds(whole)}, frame ${whole}`];
  if (row?.kind === "feature") {
    lines.push(row.title);
    if (words !== null && !row.unknown) {
      const run = words.runAt(row.bit, whole);
      lines.push(`${run.state} from ${seconds(run.start)} to ${seconds(run.stop)}`);
    }
  } else if (row?.kind === "segments") {
    lines.push(row.title);
    const one = segmentAt(row, frame, y - row.y);
    if (one !== null) lines.push(...segmentText(one, session.rateHz));
  } else if (row?.kind === "curve") {
    const value = row.values[whole] ?? Infinity;
    lines.push(row.title, value === Infinity ? "no value here" : `${value.toFixed(3)}${row.unit}`);
  }
  return lines;
}

/** Return the facts about a segment as lines of text. */
function segmentText(one: Segment, rateHz: number): string[] {
  const { start, stop, class: name, ...others } = one;
  const facts = Object.entries(others)
    .filter(([key, value]) => value !== null && value !== undefined && !["id", "pipeline"].includes(key))
    .map(([key, value]) => `${key.replaceAll("_", " ")}: ${typeof value === "number" ? +value.toFixed(3) : String(value)}`);
  const time = `${frameClock(start, rateHz)} to ${frameClock(stop, rateHz)} (${stop - start} frames)`;
  return [...(name === undefined ? [] : [name]), time, ...facts];
}

export function useWheel(session: Session, width: number, area: React.RefObject<HTMLDivElement | null>): void {
  useEffect(() => {
    const box = area.current;
    if (box === null) return;
    // not by React, whose listeners for wheels are passive
    const onWheel = (event: WheelEvent) => {
      event.preventDefault();
      const scale = event.deltaMode === 1 ? 16 : 1;
      const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
      if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
        session.pan(((sideways * scale) / width) * (session.view.to - session.view.from));
        return;
      }
      const x = event.clientX - box.getBoundingClientRect().left;
      const around = frameAt(session.view, x, width);
      session.zoom(Math.exp(-event.deltaY * scale * 0.0022), around);
    };
    box.addEventListener("wheel", onWheel, { passive: false });
    return () => box.removeEventListener("wheel", onWheel);
  }, [session, width, area]);
}

/** Drag on the strip above the axis: pan. */
export function useStrip(session: Session, width: number) {
  const to = (event: ReactPointerEvent) => {
    const x = event.clientX - event.currentTarget.getBoundingClientRect().left;
    const middle = (x / Math.max(1, width)) * session.frames;
    session.pan(middle - (session.view.from + session.view.to) / 2);
  };
  return dragging(to);
}

/** Drag on the axis: scrub. */
export function useScrub(session: Session, width: number) {
  return dragging((event) => {
    const x = event.clientX - event.currentTarget.getBoundingClientRect().left;
    session.seek(Math.floor(frameAt(session.view, Math.min(Math.max(0, x), width - 1), width)), false);
  });
}

function dragging(to: (event: ReactPointerEvent) => void) {
  return {
    onPointerDown: (event: ReactPointerEvent) => {
      event.currentTarget.setPointerCapture(event.pointerId);
      to(event);
    },
    onPointerMove: (event: ReactPointerEvent) => {
      if (event.buttons % 2 === 1) to(event);
    },
  };
}
