// The pose of a clip at one of its frames. The motion of the clip is loaded once, so that the pose follows the pointer.

import { useEffect, useMemo, useRef, useState } from "react";

import { useStore } from "../api/queries";
import { makeBody } from "../motion/body";
import { DrawnFigure, loadFigure, watch } from "../motion/figures";

export interface PoseAtProps {
  clip: { take_id: number; start: number; stop: number };
  frame: number;
  width: number;
  height: number;
  label: string;
}

export function PoseAt({ clip, frame, width, height, label }: PoseAtProps) {
  const { take_id, start, stop } = clip;
  const canvas = useRef<HTMLCanvasElement>(null);
  const [figure, setFigure] = useState<DrawnFigure | null>(null);
  const [fault, setFault] = useState("");
  const store = useStore().data;
  const body = useMemo(() => (store === undefined ? null : makeBody(store.joints, store.parents)), [store]);
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
  }, [body, take_id, start, stop, version]);
  useEffect(() => figure?.draw((frame - start + 0.5) / (stop - start), true), [figure, frame, start, stop]);
  const dense = Math.min(2, window.devicePixelRatio || 1);
  return (
    <span className="small-figure" style={{ width, height }}>
      <canvas
        ref={canvas}
        width={Math.round(width * dense)}
        height={Math.round(height * dense)}
        role="img"
        aria-label={label}
        style={{ width, height }}
      />
      {fault !== "" && <span title={fault}>no motion</span>}
    </span>
  );
}
