// The lanes in which labels are made: one for each class with labels, one for a new label, and as many as the annotations
// need so that none covers another. Segments are buttons, so that they can be reached by Tab; dragging moves them or their edges.

import { type CSSProperties, memo, type PointerEvent, type RefObject, useEffect, useMemo, useRef, useState } from "react";

import { useWidth } from "../app/useWidth";
import { colours, onTheme } from "../motion/colours";
import { drawAxis } from "../take/draw";
import { frameAt, type View, xOf } from "../take/axis";
import type { Session } from "../take/session";
import { type Annotation, type LabelRow, verdictOn } from "./edits";

export type Chosen = { kind: "label"; id: string } | { kind: "annotation"; key: string } | null;

export interface Item {
  kind: "label" | "annotation";
  key: string;
  class: string;
  start: number;
  stop: number;
  /** positive, negative, open, accepted or rejected. */
  state: string;
  text: string;
  title: string;
  label?: LabelRow;
  annotation?: Annotation;
}

export interface Lane {
  id: string;
  name: string;
  kind: "labels" | "annotations" | "new";
  class: string | null;
  items: Item[];
}

export const annotationKey = (one: Annotation): string => `${one.class}/${one.subclass ?? ""}/${one.start}/${one.stop}`;

/** Return the lanes of a take: of labels by class, an empty one for new labels or a selection, and of annotations. */
export function makeLanes(labels: readonly LabelRow[], annotations: readonly Annotation[], editable: boolean): Lane[] {
  const lanes: Lane[] = [...byClass(labels.map(labelItem))].map(([name, items]) => ({
    id: `labels/${name}`,
    name,
    kind: "labels",
    class: name,
    items,
  }));
  lanes.push({ id: "new", name: editable ? "+ new label" : "", kind: "new", class: null, items: [] });
  const decided = annotations.map((one) => annotationItem(one, verdictOn(one, labels)));
  packed(decided).forEach((items, i) =>
    lanes.push({ id: `annotations/${i}`, name: i === 0 ? "Annotations" : "", kind: "annotations", class: null, items }),
  );
  return lanes;
}

/** Return segments in as few lanes as possible, in each of which none covers another. */
export function packed(items: readonly Item[]): Item[][] {
  const found: Item[][] = [];
  for (const one of [...items].sort((a, b) => a.start - b.start || a.stop - b.stop)) {
    const free = found.find((lane) => (lane.at(-1)?.stop ?? 0) <= one.start);
    if (free === undefined) found.push([one]);
    else free.push(one);
  }
  return found;
}

function byClass(items: Item[]): [string, Item[]][] {
  const found = new Map<string, Item[]>();
  for (const one of items) found.set(one.class, [...(found.get(one.class) ?? []), one]);
  return [...found].sort(([a], [b]) => (a < b ? -1 : 1)).map(([name, own]) => [name, own.sort((a, b) => a.start - b.start)]);
}

function labelItem(one: LabelRow): Item {
  const no = one.verdict === "negative";
  const text = `${no ? "not " : ""}${one.class}${one.limb === null ? "" : ` (${one.limb})`}`;
  const by = one.annotator === null ? "" : ` by ${one.annotator}`;
  const title = `${text}, frames ${one.start} to ${one.stop}, label ${one.origin}${by}`;
  return { kind: "label", key: one.id, class: one.class, start: one.start, stop: one.stop, state: one.verdict, text, title, label: one };
}

function annotationItem(one: Annotation, decision: LabelRow | undefined): Item {
  const state = decision === undefined ? "open" : decision.verdict === "positive" ? "accepted" : "rejected";
  const sure = one.confidence === null ? "" : ` ${Math.round(100 * one.confidence)} %`;
  const mark = state === "open" ? "" : state === "accepted" ? "✓ " : "✗ ";
  const text = `${mark}${one.class}${sure}`;
  const finer = one.subclass === null || one.subclass === "" || one.subclass === one.class ? "" : ` (${one.subclass})`;
  const title = `${text}${finer}, frames ${one.start} to ${one.stop}, annotation, ${state}`;
  const key = annotationKey(one);
  return { kind: "annotation", key, class: one.class, start: one.start, stop: one.stop, state, text, title, annotation: one };
}

export interface LabelLanesProps {
  session: Session;
  lanes: readonly Lane[];
  chosen: Chosen;
  colourOf: (name: string) => string;
  editable: boolean;
  onChoose: (item: Item | null) => void;
  /** A range was drawn in a lane of labels or in the lane of new ones. */
  onDraw: (lane: Lane, start: number, stop: number) => void;
  onMove: (item: Item, start: number, stop: number) => void;
}

export const isChosen = (item: Item, chosen: Chosen): boolean =>
  chosen !== null && chosen.kind === item.kind && (chosen.kind === "label" ? chosen.id : chosen.key) === item.key;

const EDGE_PX = 7;
const CLICK_PX = 4;

interface Drag {
  x: number;
  moved: boolean;
  edge: "start" | "stop" | "whole" | "draw";
  lane: Lane;
  item: Item | null;
  start: number;
  stop: number;
}

export function LabelLanes(props: LabelLanesProps) {
  const { session, lanes } = props;
  const area = useRef<HTMLDivElement>(null);
  const axis = useRef<HTMLCanvasElement>(null);
  const width = useWidth(area);
  const view = useView(session);
  const [drag, setDrag] = useState<Drag | null>(null);
  usePainted(session, width, axis, area);
  useWheel(session, area);
  const handlers = useDrag(props, width, drag, setDrag);
  return (
    <div className="label-lanes">
      <div className="label-names">
        <div className="label-corner" />
        {lanes.map((lane) => (
          <div key={lane.id} className={`label-name label-name-${lane.kind}`}>
            <span>{lane.name}</span>
            <span className="muted">{lane.items.length || ""}</span>
          </div>
        ))}
      </div>
      <div ref={area} className="label-area" role="group" aria-label="Labels and annotations of the take; ? lists the keys" onDragStart={(event) => event.preventDefault()}>
        <canvas ref={axis} className="label-axis" aria-hidden="true" />
        {lanes.map((lane) => (
          <div key={lane.id} className={`label-lane label-lane-${lane.kind}`} data-lane={lane.id} {...handlers(lane)}>
            {lane.items.map((item) => {
              const held = drag?.item === item ? drag : null;
              const [start, stop] = held === null ? [item.start, item.stop] : [held.start, held.stop];
              return stop < view.from || start > view.to ? null : (
                <Segment
                  key={item.key}
                  item={item}
                  left={xOf(view, start, width)}
                  right={xOf(view, stop, width)}
                  chosen={isChosen(item, props.chosen)}
                  colour={props.colourOf(item.class)}
                  onChoose={props.onChoose}
                />
              );
            })}
            {drag !== null && drag.item === null && drag.lane.id === lane.id && drag.moved && (
              <div className="label-drawn" style={placed(xOf(view, drag.start, width), xOf(view, drag.stop, width))} />
            )}
          </div>
        ))}
        <div className="label-selection" aria-hidden="true" />
        <div className="label-playhead" aria-hidden="true" />
      </div>
    </div>
  );
}

const placed = (left: number, right: number): CSSProperties => ({ left, width: Math.max(2, right - left) });

const Segment = memo(function Segment(props: {
  item: Item;
  left: number;
  right: number;
  chosen: boolean;
  colour: string;
  onChoose: (item: Item) => void;
}) {
  const { item, left, right, chosen, colour, onChoose } = props;
  return (
    <button
      type="button"
      className={`label-segment label-${item.kind} label-${item.state}`}
      data-segment={item.key}
      aria-label={item.title}
      aria-pressed={chosen}
      title={item.title}
      style={{ ...placed(left, right), "--kx-own": colour } as CSSProperties}
      onClick={(event) => event.detail === 0 && onChoose(item)}
    >
      <span>{item.text}</span>
    </button>
  );
});

function useView(session: Session): View {
  const [view, setView] = useState(session.view);
  useEffect(() => session.paint((changes) => changes.view && setView(session.view)), [session]);
  return view;
}

/** Draw the axis, and move the playhead and the selection, without React. */
function usePainted(session: Session, width: number, axis: RefObject<HTMLCanvasElement | null>, area: RefObject<HTMLDivElement | null>): void {
  useEffect(() => {
    const [canvas, box] = [axis.current, area.current];
    const [selection, head] = ["label-selection", "label-playhead"].map((name) => box?.querySelector<HTMLElement>(`.${name}`));
    if (canvas === null || selection == null || head == null || width < 1) return;
    const dense = Math.min(2, window.devicePixelRatio || 1);
    [canvas.width, canvas.height] = [Math.round(width * dense), Math.round(22 * dense)];
    const pen = canvas.getContext("2d") as CanvasRenderingContext2D;
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    const end = session.paint((changes) => {
      if (changes.view || changes.content) {
        pen.font = "11px system-ui, sans-serif";
        pen.textBaseline = "middle";
        drawAxis(pen, session.view, session.rateHz, width, 22, colours());
      }
      const x = xOf(session.view, session.seen, width);
      head.style.transform = `translateX(${x}px)`;
      head.style.visibility = x < 0 || x > width ? "hidden" : "visible";
      const range = session.brushed ?? session.shown.selection;
      selection.style.visibility = range === null ? "hidden" : "visible";
      if (range === null) return;
      const from = Math.max(0, xOf(session.view, range[0], width));
      selection.style.transform = `translateX(${from}px)`;
      selection.style.width = `${Math.max(0, Math.min(width, xOf(session.view, range[1], width)) - from)}px`;
    });
    const endTheme = onTheme(() => session.changed("content"));
    return () => {
      end();
      endTheme();
    };
  }, [session, width, axis, area]);
}

/** Zoom by the wheel around the pointer, pan with Shift or by a sideways wheel. */
function useWheel(session: Session, area: RefObject<HTMLDivElement | null>): void {
  useEffect(() => {
    const box = area.current;
    if (box === null) return;
    const turn = (event: WheelEvent) => {
      event.preventDefault();
      const frames = session.view.to - session.view.from;
      const { left, width } = box.getBoundingClientRect();
      const sideways = event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY);
      if (sideways) session.pan(((event.deltaX || event.deltaY) / Math.max(1, width)) * frames);
      else session.zoom(Math.exp(-event.deltaY / 400), frameAt(session.view, event.clientX - left, width));
    };
    box.addEventListener("wheel", turn, { passive: false });
    return () => box.removeEventListener("wheel", turn);
  }, [session, area]);
}

function useDrag(props: LabelLanesProps, width: number, drag: Drag | null, setDrag: (drag: Drag | null) => void) {
  const { session, editable, onChoose, onDraw, onMove } = props;
  const items = useMemo(() => new Map(props.lanes.flatMap((lane) => lane.items.map((one) => [`${lane.id} ${one.key}`, one] as const))), [props.lanes]);
  const origin = useRef(0);
  const xIn = (event: PointerEvent<HTMLDivElement>) => event.clientX - event.currentTarget.getBoundingClientRect().left;
  const frame = (x: number) => Math.min(Math.max(0, frameAt(session.view, x, width)), session.frames);
  const down = (lane: Lane) => (event: PointerEvent<HTMLDivElement>) => {
    if (event.button !== 0) return;
    const x = xIn(event);
    const key = (event.target as HTMLElement).closest<HTMLElement>("[data-segment]")?.dataset.segment;
    const item = key === undefined ? null : (items.get(`${lane.id} ${key}`) ?? null);
    event.currentTarget.setPointerCapture(event.pointerId);
    origin.current = frame(x);
    const at = Math.floor(origin.current);
    const base = { x, moved: false, lane };
    if (item === null) setDrag({ ...base, item, edge: "draw", start: at, stop: at + 1 });
    else setDrag({ ...base, item, edge: edgeOf(item, x, session.view, width), start: item.start, stop: item.stop });
  };
  const move = (event: PointerEvent<HTMLDivElement>) => {
    if (drag === null) return;
    const x = xIn(event);
    const moved = drag.moved || Math.abs(x - drag.x) >= CLICK_PX;
    if (!moved) return;
    if (drag.item !== null && (drag.item.kind === "annotation" || !editable)) return;
    const [start, stop] = dragged(drag, origin.current, frame(x), session.frames);
    session.hover(drag.edge === "stop" ? stop - 1 : drag.edge === "draw" ? Math.floor(frame(x)) : start);
    setDrag({ ...drag, moved, start, stop });
  };
  const up = (event: PointerEvent<HTMLDivElement>) => {
    if (drag === null) return;
    setDrag(null);
    session.hover(null);
    if (!drag.moved) {
      onChoose(drag.item);
      session.seek(drag.item === null ? Math.floor(frame(xIn(event))) : drag.item.start);
      if (drag.item === null) session.select(null);
    } else if (drag.item === null) {
      session.select([drag.start, drag.stop]);
      if (editable && drag.lane.kind !== "annotations") onDraw(drag.lane, drag.start, drag.stop);
    } else if (drag.start !== drag.item.start || drag.stop !== drag.item.stop) onMove(drag.item, drag.start, drag.stop);
  };
  const cancel = () => {
    setDrag(null);
    session.hover(null);
  };
  return (lane: Lane) => ({ onPointerDown: down(lane), onPointerMove: move, onPointerUp: up, onPointerCancel: cancel });
}

function edgeOf(item: Item, x: number, view: View, width: number): "start" | "stop" | "whole" {
  const [left, right] = [xOf(view, item.start, width), xOf(view, item.stop, width)];
  const reach = Math.min(EDGE_PX, (right - left) / 3);
  return x - left <= reach ? "start" : right - x <= reach ? "stop" : "whole";
}

/** Return the edges of a segment while it is dragged from a frame to another. */
export function dragged(drag: Pick<Drag, "edge" | "item">, from: number, to: number, frames: number): [number, number] {
  const { item, edge } = drag;
  if (item === null) {
    const [low, high] = from < to ? [from, to] : [to, from];
    return [Math.floor(low), Math.min(frames, Math.max(Math.floor(low) + 1, Math.ceil(high)))];
  }
  const by = Math.round(to - from);
  if (edge === "start") return [Math.min(Math.max(0, item.start + by), item.stop - 1), item.stop];
  if (edge === "stop") return [item.start, Math.max(item.start + 1, Math.min(frames, item.stop + by))];
  const shift = Math.min(Math.max(by, -item.start), frames - item.stop);
  return [item.start + shift, item.stop + shift];
}
