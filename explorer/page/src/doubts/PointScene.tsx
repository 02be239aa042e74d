// Points in 3D as a picture of lines and dots: drag turns it, the wheel goes closer, and a click chooses a point.

import { useElementSize } from "@mantine/hooks";
import { useEffect, useMemo, useRef, useState } from "react";

import { FlatCamera, NEAR } from "../motion/flatCamera";
import { nearest } from "./scene";
import type { Frames } from "./types";

/** Radians of a turn by one pixel. */
const TURN = 0.008;
/** Pixels within which a press without a move chooses a point. */
const REACH = 14;
const HEIGHT = 380;

export interface Dot {
  label: string;
  side: "left" | "right" | "middle" | "none";
  /** Whether a person has named it. */
  named?: boolean;
}

interface Props {
  label: string;
  scene: Frames;
  frame: number;
  dots: readonly Dot[];
  /** Pairs of points with a line between them. */
  lines: readonly (readonly [number, number])[];
  chosen?: number;
  onChoose?: (index: number) => void;
}

export function PointScene({ label, scene, frame, dots, lines, chosen = -1, onChoose }: Props) {
  const { ref, width } = useElementSize();
  const box = useRef<SVGSVGElement>(null);
  const [view, setView] = useState({ yaw: 0.6, pitch: 0.15, distance: 3.9 });
  const [over, setOver] = useState(-1);
  const pressed = useRef<{ x: number; y: number; moved: boolean } | null>(null);
  const places = scene[Math.min(frame, scene.length - 1)] ?? [];
  const points = useMemo(() => projected(places, view, width), [places, view, width]);
  useWheel(box, (by) => setView((old) => turned(old, 0, 0, by)));
  const at = (event: React.PointerEvent): readonly [number, number] => {
    const area = (box.current as SVGSVGElement).getBoundingClientRect();
    return [event.clientX - area.left, event.clientY - area.top];
  };
  const shown = over >= 0 ? over : chosen;
  return (
    <div ref={ref} className="doubts-scene">
      {width > 0 && (
        <svg
          ref={box}
          width={width}
          height={HEIGHT}
          role="img"
          aria-label={label}
          onPointerDown={(event) => {
            event.currentTarget.setPointerCapture(event.pointerId);
            pressed.current = { x: event.clientX, y: event.clientY, moved: false };
          }}
          onPointerMove={(event) => {
            const press = pressed.current;
            if (press === null) {
              setOver(onChoose === undefined ? -1 : nearest(points, ...at(event), REACH));
              return;
            }
            const [dx, dy] = [event.clientX - press.x, event.clientY - press.y];
            if (!press.moved && Math.hypot(dx, dy) < 4) return;
            pressed.current = { x: event.clientX, y: event.clientY, moved: true };
            setView((old) => turned(old, -TURN * dx, TURN * dy, 1));
          }}
          onPointerUp={(event) => {
            const found = pressed.current?.moved === false ? nearest(points, ...at(event), REACH) : -1;
            pressed.current = null;
            if (found >= 0) onChoose?.(found);
          }}
          onPointerLeave={() => setOver(-1)}
        >
          {lines.map(([one, other]) => {
            const [a, b] = [points[one], points[other]];
            return a && b ? (
              <line key={`${one} ${other}`} x1={a[0]} y1={a[1]} x2={b[0]} y2={b[1]} className={`doubts-line ${dots[other]?.side ?? ""}`} />
            ) : null;
          })}
          {points.map((point, index) =>
            point === null ? null : (
              <circle
                key={index}
                cx={point[0]}
                cy={point[1]}
                r={index === chosen ? 7 : 4.5}
                data-node={dots[index]?.label}
                className={`doubts-dot ${dots[index]?.side ?? "none"}${dots[index]?.named ? " named" : ""}${index === chosen ? " chosen" : ""}`}
              />
            ),
          )}
          {shown >= 0 && points[shown] && (
            <text x={(points[shown]?.[0] ?? 0) + 9} y={(points[shown]?.[1] ?? 0) - 7} className="doubts-label">
              {dots[shown]?.label}
            </text>
          )}
        </svg>
      )}
    </div>
  );
}

interface View {
  yaw: number;
  pitch: number;
  distance: number;
}

function cameraOf(view: View, width = 1): FlatCamera {
  const camera = new FlatCamera();
  Object.assign(camera, { ...view, width, height: HEIGHT, target: [0, 0, 0] });
  return camera;
}

function turned(view: View, yaw: number, pitch: number, distance: number): View {
  const camera = cameraOf(view);
  camera.turn(yaw, pitch, distance);
  return { yaw: camera.yaw, pitch: camera.pitch, distance: camera.distance };
}

function projected(places: Frames[number], view: View, width: number): (readonly [number, number] | null)[] {
  const camera = cameraOf(view, width);
  camera.aim();
  const out = new Float32Array(3);
  return places.map((place) => {
    if (place === null) return null;
    camera.project(...place, out, 0);
    const [x, y, depth] = out as unknown as [number, number, number];
    return depth > NEAR ? ([x, y] as const) : null;
  });
}

/** Call a function with a factor when the wheel turns over an element, which does not scroll the page then. */
function useWheel(box: React.RefObject<SVGSVGElement | null>, zoom: (by: number) => void): void {
  const call = useRef(zoom);
  call.current = zoom;
  useEffect(() => {
    const element = box.current;
    const turn = (event: WheelEvent) => {
      event.preventDefault();
      call.current(event.deltaY > 0 ? 1.1 : 1 / 1.1);
    };
    element?.addEventListener("wheel", turn, { passive: false });
    return () => element?.removeEventListener("wheel", turn);
  });
}
