import { type PointerEvent, useCallback, useEffect, useLayoutEffect, useRef, useState } from "react";

import { Fault } from "../app/Fault";
import { useShortcuts } from "../app/shortcuts";
import { type ArchiveMap, type Direction, inside, type Legend, nearest, neighbour, NO_FIT, type Point } from "./map";
import { type Look, MapPicture, WHOLE } from "./mapPicture";

export type Tool = "move" | "box" | "lasso";

interface Props {
  map: ArchiveMap;
  legend: Legend;
  chosen: ReadonlySet<number>;
  /** What of the map is in sight; it changes while a person zooms or moves, and `onLook` tells of it once that rests. */
  look: Look;
  onLook: (look: Look) => void;
  tool: Tool;
  active: number;
  onActive: (point: number) => void;
  /** Points were chosen with a lasso, instead of or beside those chosen before. */
  onChoose: (points: number[], more: boolean) => void;
  onOpen: (point: number) => void;
  /** The point under the pointer, and where that is. */
  onPointed: (point: number, at: Point) => void;
  describedBy: string;
}

const NEAR_PX = 14;
const CLICK_PX = 4;
const LOOK_MS = 250;
const STEP_PX = 3;

interface Drag {
  from: Point;
  look: Look;
  tool: Tool;
  moved: boolean;
  more: boolean;
}

/** The points of the map, under the pointer and keys. */
export function MapCanvas(props: Props) {
  const { map, legend, chosen, look, onLook, tool, active, onActive, onChoose, onOpen, onPointed } = props;
  const box = useRef<HTMLDivElement>(null);
  const points = useRef<HTMLCanvasElement>(null);
  const above = useRef<HTMLCanvasElement>(null);
  const picture = useRef<MapPicture>(null);
  const drag = useRef<Drag>(null);
  const fingers = useRef(new Map<number, Point>());
  const resting = useRef<ReturnType<typeof setTimeout>>(undefined);
  const [fault, setFault] = useState<unknown>(null);
  const counts = useCallback((point: number) => legend.codes[point] !== NO_FIT, [legend]);

  useLayoutEffect(() => {
    if (points.current === null || above.current === null || box.current === null) return;
    let made: MapPicture;
    try {
      made = new MapPicture(points.current, above.current);
    } catch {
      setFault(new Error("the browser draws no WebGL; “Map as a table” has the clusters"));
      return;
    }
    picture.current = made;
    const observer = new ResizeObserver(([entry]) => {
      if (entry !== undefined) made.resize(entry.contentRect.width, entry.contentRect.height);
    });
    observer.observe(box.current);
    return () => {
      observer.disconnect();
      made.end();
      picture.current = null;
    };
  }, []);
  useEffect(() => picture.current?.show(map, legend, chosen), [map, legend, chosen]);
  useEffect(() => {
    const drawn = picture.current;
    if (drawn === null) return;
    const moved = drawn.look !== look;
    drawn.look = look;
    drawn.active = active;
    drawn.draw(moved);
  }, [look, active]);

  const lookAt = useCallback(
    (next: Look) => {
      const drawn = picture.current;
      if (drawn === null) return;
      drawn.move(next);
      clearTimeout(resting.current);
      resting.current = setTimeout(() => {
        picture.current?.rest();
        onLook(next);
      }, LOOK_MS);
    },
    [onLook],
  );
  useEffect(() => () => clearTimeout(resting.current), []);
  const zoomBy = useCallback(
    (factor: number, at?: Point) => {
      const drawn = picture.current;
      const { clientWidth, clientHeight } = box.current ?? { clientWidth: 0, clientHeight: 0 };
      if (drawn !== null) lookAt(drawn.zoomed(factor, at ?? [clientWidth / 2, clientHeight / 2]));
    },
    [lookAt],
  );
  // React listens to wheels passively, and the page would scroll as well.
  useEffect(() => {
    const element = box.current;
    const onWheel = (event: WheelEvent) => {
      event.preventDefault();
      const { left, top } = (element as HTMLDivElement).getBoundingClientRect();
      zoomBy(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0016)), [event.clientX - left, event.clientY - top]);
    };
    element?.addEventListener("wheel", onWheel, { passive: false });
    return () => element?.removeEventListener("wheel", onWheel);
  }, [zoomBy]);

  const go = (key: Direction) => {
    const from = active >= 0 ? active : nearest(map, [look.x, look.y], Infinity, counts);
    const next = active >= 0 ? neighbour(map, from, key, counts) : from;
    onActive(next);
    const drawn = picture.current;
    if (drawn === null || box.current === null || next < 0) return;
    const [x, y] = drawn.onScreen(next);
    const { clientWidth, clientHeight } = box.current;
    if (x < 0 || y < 0 || x > clientWidth || y > clientHeight)
      lookAt({ ...drawn.look, x: map.x[next] as number, y: map.y[next] as number });
  };
  const arrows: [Direction, string][] = [
    ["ArrowLeft", "left"],
    ["ArrowRight", "right"],
    ["ArrowUp", "above"],
    ["ArrowDown", "below"],
  ];
  useShortcuts("Map", [
    ...arrows.map(([keys, where]) => ({ keys, what: `Go to the nearest point ${where}`, run: () => go(keys) })),
    { keys: "Enter", what: "Open the take of the point", run: () => active >= 0 && onOpen(active) },
    { keys: " ", what: "Choose the point, or not", run: () => active >= 0 && onChoose([active], true) },
    { keys: "Escape", what: "Choose nothing", run: () => onChoose([], false) },
    { keys: "+", what: "Closer", run: () => zoomBy(1.5) },
    { keys: "-", what: "Farther", run: () => zoomBy(1 / 1.5) },
    { keys: "0", what: "The whole map", run: () => lookAt(WHOLE) },
  ]);

  const at = (event: PointerEvent): Point => {
    const { left, top } = event.currentTarget.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  };
  const pointAt = (place: Point): number => {
    const drawn = picture.current;
    return drawn === null ? -1 : nearest(map, drawn.onMap(place), NEAR_PX / drawn.scale, counts);
  };
  const onDown = (event: PointerEvent<HTMLDivElement>) => {
    if (event.button !== 0 || picture.current === null) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    const place = at(event);
    fingers.current.set(event.pointerId, place);
    const used = event.shiftKey && tool === "move" ? "lasso" : tool;
    const more = event.shiftKey || event.ctrlKey || event.metaKey;
    drag.current = { from: place, look: picture.current.look, tool: used, moved: fingers.current.size > 1, more };
    picture.current.lasso = [];
  };
  const onMove = (event: PointerEvent<HTMLDivElement>) => {
    const drawn = picture.current;
    if (drawn === null) return;
    const place = at(event);
    const before = fingers.current.get(event.pointerId);
    if (before !== undefined) fingers.current.set(event.pointerId, place);
    if (before !== undefined && fingers.current.size === 2) return pinch(drawn, event.pointerId, before, place);
    const held = drag.current;
    if (held === null || before === undefined) return point(drawn, pointAt(place), place);
    if (!held.moved && Math.hypot(place[0] - held.from[0], place[1] - held.from[1]) < CLICK_PX) return;
    held.moved = true;
    point(drawn, -1, place);
    if (held.tool === "move") {
      const [u, v] = [place[0] - held.from[0], place[1] - held.from[1]];
      lookAt({ ...held.look, x: held.look.x - u / drawn.scale, y: held.look.y + v / drawn.scale });
    } else {
      const [[a, b], [c, d]] = [held.from, place];
      const last = drawn.lasso[drawn.lasso.length - 1] ?? held.from;
      if (held.tool === "box") drawn.lasso = [[a, b], [c, b], [c, d], [a, d]];
      else if (Math.hypot(c - last[0], d - last[1]) >= STEP_PX) drawn.lasso = [...(drawn.lasso.length > 0 ? drawn.lasso : [held.from]), place];
      drawn.draw(false);
    }
  };
  /** Zoom by the distance of two fingers, around the one that rests. */
  const pinch = (drawn: MapPicture, id: number, before: Point, now: Point) => {
    const other = [...fingers.current].find(([one]) => one !== id)?.[1];
    if (other === undefined) return;
    const distance = (one: Point) => Math.max(1, Math.hypot(one[0] - other[0], one[1] - other[1]));
    lookAt(drawn.zoomed(distance(now) / distance(before), other));
    if (drag.current !== null) drag.current = { ...drag.current, from: other, look: drawn.look, tool: "move", moved: true };
  };
  const point = (drawn: MapPicture, found: number, place: Point) => {
    if (drawn.pointed !== found) {
      drawn.pointed = found;
      drawn.draw(false);
    }
    onPointed(found, place);
  };
  const onUp = (event: PointerEvent<HTMLDivElement>) => {
    fingers.current.delete(event.pointerId);
    const held = drag.current;
    const drawn = picture.current;
    if (held === null || drawn === null || fingers.current.size > 0) return;
    drag.current = null;
    if (held.moved) {
      if (held.tool !== "move" && drawn.lasso.length > 2)
        onChoose(inside(map, drawn.lasso.map((corner) => drawn.onMap(corner)), counts), held.more);
    } else if (event.type === "pointerup") {
      const found = pointAt(at(event));
      if (found < 0) onChoose([], false);
      else if (held.more) onChoose([found], true);
      else onOpen(found);
    }
    drawn.lasso = [];
    drawn.draw(false);
  };
  return (
    <div
      ref={box}
      className="map-box"
      role="application"
      aria-label="Map of the archive"
      aria-describedby={props.describedBy}
      tabIndex={0}
      data-tool={tool}
      onPointerDown={onDown}
      onPointerMove={onMove}
      onPointerUp={onUp}
      onPointerCancel={onUp}
      onPointerLeave={() => picture.current !== null && point(picture.current, -1, [0, 0])}
    >
      <canvas ref={points} aria-hidden />
      <canvas ref={above} aria-hidden />
      {fault !== null && <Fault fault={fault} />}
    </div>
  );
}
