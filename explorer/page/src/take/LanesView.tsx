// The lanes of a take: names on the left, and on the right canvases that share one axis of time.

import { useEffect, useMemo, useRef } from "react";

import type { Feature } from "../api/types";
import { useWidth } from "../app/useWidth";
import { colours, onTheme } from "../motion/colours";
import { frameClock, xOf } from "./axis";
import { drawAxis, drawCurve, drawSegments, FeatureImage } from "./draw";
import { usePointer, useScrub, useStrip, useWheel } from "./pointer";
import { type CurveRow, makeRows, type Row } from "./rows";
import type { Session } from "./session";
import type { Lane, Segment } from "./types";
import type { Words } from "./words";

const AXIS = 24;
const STRIP = 16;

export interface LanesProps {
  session: Session;
  words: Words | null;
  lanes: readonly Lane[];
  curves: readonly CurveRow[];
  features: readonly Feature[];
  unknown: ReadonlySet<number>;
  closed: ReadonlySet<string>;
  colourOf: (segment: Segment) => string;
  onGroup: (id: string) => void;
  /** A segment was clicked, or a place of a curve. */
  onPick: (row: Row, segment: Segment | null, frame: number) => void;
}

export function LanesView(props: LanesProps) {
  const { session, lanes, curves, features, unknown, closed, onGroup } = props;
  const rows = useMemo(
    () => makeRows(lanes, curves, features, unknown, closed),
    [lanes, curves, features, unknown, closed],
  );
  const height = rows.reduce((sum, row) => Math.max(sum, row.y + row.height), 0);
  const area = useRef<HTMLDivElement>(null);
  const base = useRef<HTMLCanvasElement>(null);
  const axis = useRef<HTMLCanvasElement>(null);
  const strip = useRef<HTMLCanvasElement>(null);
  const marks = useRef<HTMLDivElement>(null);
  const tip = useRef<HTMLDivElement>(null);
  const width = useWidth(area);
  usePainter(props, rows, width, height, { base, axis, strip, marks });
  const pointer = usePointer(props, rows, width, area, tip);
  useWheel(session, width, area);
  return (
    <div className="lanes" style={{ gridTemplateRows: `${STRIP + AXIS}px ${height}px` }}>
      <div className="lanes-corner">{frameClock(session.frames, session.rateHz, 1)}</div>
      <div className="lanes-top">
        <canvas ref={strip} className="lanes-strip" style={{ height: STRIP }} {...useStrip(session, width)} />
        <canvas ref={axis} style={{ height: AXIS }} {...useScrub(session, width)} />
      </div>
      <div className="lanes-names" role="presentation">
        {rows.map((row) =>
          row.kind === "group" ? (
            <button
              key={row.id}
              type="button"
              className="lanes-group"
              style={{ top: row.y, height: row.height }}
              aria-expanded={row.open}
              title={row.title}
              onClick={() => onGroup(row.id)}
            >
              {row.open ? "▾" : "▸"} {row.name} <span className="muted">{row.title}</span>
            </button>
          ) : (
            <div key={row.id} className={`lanes-name lanes-${row.kind}`} style={{ top: row.y, height: row.height }} title={row.title}>
              {row.kind === "feature" && <i className={`side-${row.side}`} />}
              <span className={row.kind === "feature" && row.unknown ? "muted" : undefined}>
                {shortened(row.name)}
                {row.kind === "feature" && row.unknown ? " (unknown)" : ""}
              </span>
            </div>
          ),
        )}
      </div>
      <div
        ref={area}
        className="lanes-area"
        role="group"
        aria-label="Lanes of the take. Keys: arrows step, plus and minus zoom, [ and ] select; the table below has the same."
        {...pointer}
      >
        <canvas ref={base} style={{ height }} />
        <div ref={marks} className="lanes-marks" aria-hidden="true">
          <div className="mark-selection" />
          <div className="mark-hover" />
          <div className="mark-playhead" />
        </div>
        <div ref={tip} className="lanes-tip" hidden />
      </div>
    </div>
  );
}

/** Shorten a long name in its middle: what tells methods apart stands at the end of their names. */
function shortened(name: string): string {
  return name.length > 30 ? `${name.slice(0, 9)}…${name.slice(-19)}` : name;
}

interface Canvases {
  base: React.RefObject<HTMLCanvasElement | null>;
  axis: React.RefObject<HTMLCanvasElement | null>;
  strip: React.RefObject<HTMLCanvasElement | null>;
  marks: React.RefObject<HTMLDivElement | null>;
}

/** Draw the lanes when the view or they change, and move the marks at every picture. */
function usePainter(props: LanesProps, rows: readonly Row[], width: number, height: number, on: Canvases): void {
  const { session, words, colourOf } = props;
  const { base, axis, strip, marks } = on;
  useEffect(() => {
    const [canvas, top, small, box] = [base.current, axis.current, strip.current, marks.current];
    if (canvas === null || top === null || small === null || box === null || width < 1) return;
    const dense = Math.min(2, window.devicePixelRatio || 1);
    const pen = fit(canvas, width, height, dense);
    const topPen = fit(top, width, AXIS, dense);
    const smallPen = fit(small, width, STRIP, dense);
    const image = new FeatureImage();
    const lines = [...box.children] as HTMLElement[];
    const drawAll = () => {
      const theme = colours();
      drawLanes(pen, rows, session, words, width, height, image, colourOf);
      topPen.font = "11px system-ui, sans-serif";
      topPen.textBaseline = "middle";
      drawAxis(topPen, session.view, session.rateHz, width, AXIS, theme);
    };
    const end = session.paint((changes) => {
      if (words !== null && words.ready < words.frames) {
        words.prepare();
        session.changed("view"); // the lanes alone are to be drawn anew
      }
      if (changes.view || changes.content) {
        drawAll();
        drawStrip(smallPen, session, width);
      }
      if (changes.time || changes.view || changes.content) moveMarks(lines, session, width);
    });
    const endTheme = onTheme(() => session.changed("content"));
    return () => {
      end();
      endTheme();
    };
  }, [session, words, rows, width, height, colourOf, base, axis, strip, marks]);
}

function fit(canvas: HTMLCanvasElement, width: number, height: number, dense: number): CanvasRenderingContext2D {
  canvas.width = Math.round(width * dense);
  canvas.height = Math.max(1, Math.round(height * dense));
  const pen = canvas.getContext("2d") as CanvasRenderingContext2D;
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  return pen;
}

function drawLanes(
  pen: CanvasRenderingContext2D,
  rows: readonly Row[],
  session: Session,
  words: Words | null,
  width: number,
  height: number,
  image: FeatureImage,
  colourOf: (segment: Segment) => string,
): void {
  const theme = colours();
  pen.clearRect(0, 0, width, height);
  pen.font = "11px system-ui, sans-serif";
  pen.textBaseline = "middle";
  for (const row of rows) {
    if (row.kind === "group") {
      pen.fillStyle = theme.raised;
      pen.fillRect(0, row.y, width, row.height);
    } else if (row.kind === "segments") drawSegments(pen, row, session.view, width, theme, colourOf);
    else if (row.kind === "curve") drawCurve(pen, row, session.view, width, theme);
  }
  if (words !== null) image.draw(pen, rows, words, session.view, width, theme);
}

function drawStrip(pen: CanvasRenderingContext2D, session: Session, width: number): void {
  const theme = colours();
  const all = { from: 0, to: session.frames };
  pen.clearRect(0, 0, width, STRIP);
  pen.fillStyle = theme.line;
  pen.fillRect(0, 4, width, STRIP - 8);
  const from = xOf(all, session.view.from, width);
  pen.fillStyle = theme.muted;
  pen.fillRect(from, 3, Math.max(4, xOf(all, session.view.to, width) - from), STRIP - 6);
}

function moveMarks([selection, hover, head]: HTMLElement[], session: Session, width: number): void {
  const { view } = session;
  const chosen = session.brushed ?? session.shown.selection;
  const show = (mark: HTMLElement | undefined, from: number | null, to?: number) => {
    if (mark === undefined) return;
    const inside = from !== null && (to ?? from) >= view.from && from <= view.to;
    mark.style.visibility = inside ? "visible" : "hidden";
    if (!inside || from === null) return;
    const x = Math.max(-2, xOf(view, from, width));
    mark.style.transform = `translateX(${x.toFixed(1)}px)`;
    if (to !== undefined) mark.style.width = `${Math.max(1, Math.min(width, xOf(view, to, width)) - x).toFixed(1)}px`;
  };
  show(selection, chosen === null ? null : chosen[0], chosen?.[1]);
  show(hover, session.hovered);
  show(head, session.frame);
}
