// A small moving figure for grids and walls: an interval of a take, seen from its front, in a loop.
//
//     <SmallFigure item={{ take_id, start, stop }} label="walk_01, 2.0 to 4.5 s" />
//     <SmallFigure item={hit} width={120} height={140} moves={focused} />
//     <SmallFigure item={clip} at={0.25} label="the pose after a quarter of the clip" />
//
// The motion comes by itself: figures that appear together are asked for in one request (POST /api/figures), and kept.
// All figures share one animation loop, which skips those that are off the screen. Where the person prefers reduced
// motion, a figure shows its middle pose and moves only while `moves` is true. It has no controls: put it into a button
// or a cell of a grid. `label` is its text for screen readers; without one it is decoration beside other text.

import { memo, useEffect, useMemo, useRef, useState } from "react";

import { useStore } from "../api/queries";
import { makeBody } from "./body";
import { DrawnFigure, type FigureItem, loadFigure, move, rest, watch } from "./figures";
import "./motion.css";

export interface SmallFigureProps {
  item: FigureItem;
  width?: number;
  height?: number;
  /** True: it moves, also against reduced motion; false: it stands; otherwise as the person prefers. */
  moves?: boolean;
  /** It stands, in the pose at this share of the interval; the motion is loaded once for all of them. */
  at?: number;
  label?: string;
}

export const SmallFigure = memo(function SmallFigure({
  item,
  width = 96,
  height = 112,
  moves,
  at,
  label,
}: SmallFigureProps) {
  const { take_id, start, stop } = item;
  const canvas = useRef<HTMLCanvasElement>(null);
  const [figure, setFigure] = useState<DrawnFigure | null>(null);
  const [fault, setFault] = useState("");
  const store = useStore().data;
  const body = useMemo(
    () => (store === undefined ? null : makeBody(store.joints, store.parents)),
    [store],
  );
  const version = store?.version ?? 0;
  useEffect(() => {
    if (body === null) return;
    let current = true;
    let end = () => {};
    setFault("");
    loadFigure({ take_id, start, stop }, version).then(
      (block) => {
        if (!current || canvas.current === null) return;
        const drawn = new DrawnFigure(canvas.current, body, block);
        end = watch(drawn);
        setFigure(drawn);
      },
      (reason: unknown) => current && setFault(reason instanceof Error ? reason.message : String(reason)),
    );
    return () => {
      current = false;
      end();
      setFigure(null);
    };
  }, [body, take_id, start, stop, version, width, height]);
  // Before what moves it: a figure at rest shows the pose that was drawn last.
  useEffect(() => figure?.draw(at ?? 0.5, true), [figure, at]);
  useEffect(() => {
    if (figure === null || at !== undefined) return;
    const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (!(moves ?? !calm)) return;
    move(figure);
    return () => rest(figure);
  }, [figure, moves, at === undefined]);
  const dense = Math.min(2, window.devicePixelRatio || 1);
  return (
    <span className="small-figure" style={{ width, height }}>
      <canvas
        ref={canvas}
        width={Math.round(width * dense)}
        height={Math.round(height * dense)}
        role={label === undefined ? "presentation" : "img"}
        aria-label={label}
        style={{ width, height }}
      />
      {fault !== "" && <span title={fault}>no motion</span>}
    </span>
  );
});
