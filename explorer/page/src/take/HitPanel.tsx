// A template beside its hit in the take: hovering a column shows the pose of the hit at that column.

import { Button, Group, Text } from "@mantine/core";
import { type PointerEvent, useEffect, useRef } from "react";
import { Link } from "wouter";

import { Fault } from "../app/Fault";
import type { Feature } from "../api/types";
import { sideOf } from "../motion/body";
import { colours, onTheme } from "../motion/colours";
import { frameClock } from "./axis";
import { Panel } from "./panels";
import type { Session } from "./session";
import type { FittedHit, TemplateImage } from "./types";

const ROW = 4;

export interface HitPanelProps {
  session: Session;
  name: string;
  hit: FittedHit | undefined;
  image: TemplateImage | undefined;
  fault: unknown;
  features: readonly Feature[];
  onBeside: (hit: FittedHit) => void;
  onClose: () => void;
}

export function HitPanel({ session, name, hit, image, fault, features, onBeside, onClose }: HitPanelProps) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const cursor = useRef<HTMLDivElement>(null);
  const text = useRef<HTMLDivElement>(null);
  useEffect(() => {
    if (canvas.current === null || image === undefined) return;
    const shown = canvas.current;
    const draw = () => drawTemplate(shown, image, features);
    draw();
    return onTheme(draw);
  }, [image, features]);
  useEffect(() => {
    if (hit === undefined || image === undefined) return;
    return session.paint(() => {
      const mark = cursor.current;
      if (mark === null) return;
      const column = hit.columns[Math.floor(session.seen) - hit.start];
      mark.style.visibility = column === undefined ? "hidden" : "visible";
      if (column !== undefined) mark.style.left = `${((column + 0.5) / image.columns) * 100}%`;
    });
  }, [session, hit, image]);
  const onPointerMove = (event: PointerEvent) => {
    if (hit === undefined || image === undefined) return;
    const box = event.currentTarget.getBoundingClientRect();
    const column = ((event.clientX - box.left) / box.width) * image.columns;
    session.play(false);
    session.hover(frameOfColumn(hit, column));
    const feature = features[Math.min(features.length - 1, Math.floor(((event.clientY - box.top) / box.height) * features.length))];
    const share = feature === undefined ? undefined : image.values[feature.bit]?.[Math.min(image.columns - 1, Math.floor(column))];
    if (text.current !== null && feature !== undefined)
      text.current.textContent = `column ${Math.floor(column) + 1} of ${image.columns}: ${feature.name}, on in ${Math.round(100 * (share ?? 0))} % of the clips`;
  };
  return (
    <Panel title={`Template ${name}`}>
      {fault !== null && fault !== undefined && <Fault fault={fault} />}
      {hit !== undefined && (
        <Text size="sm">
          {hit.below ? "Hit" : "Nearest place"} from {frameClock(hit.start, session.rateHz)} to{" "}
          {frameClock(hit.stop, session.rateHz)}, cost {hit.cost.toFixed(3)}
          {hit.below ? "" : ": not below τ"}
        </Text>
      )}
      <div className="template-image" onPointerMove={onPointerMove} onPointerLeave={() => session.hover(null)}>
        <canvas
          ref={canvas}
          role="img"
          aria-label={`The template ${name}: ${features.length} features in ${image?.columns ?? 0} columns. Hover a column to see the pose of the hit.`}
        />
        <div ref={cursor} className="template-cursor" />
      </div>
      <div ref={text} className="muted template-text">
        Features from top to bottom, time to the right. Hover to see the pose of the hit.
      </div>
      <Group gap={6} mt={6}>
        {hit !== undefined && (
          <Button size="compact-sm" variant="default" onClick={() => session.select([hit.start, hit.stop])}>
            Select the hit
          </Button>
        )}
        {hit?.example != null && (
          <Button size="compact-sm" variant="default" onClick={() => onBeside(hit)}>
            Beside its nearest clip
          </Button>
        )}
        <Button size="compact-sm" variant="default" component={Link} href={`/templates?${new URLSearchParams({ template: name }).toString()}`}>
          Open the template
        </Button>
        <Button size="compact-sm" variant="subtle" onClick={onClose}>
          Close
        </Button>
      </Group>
    </Panel>
  );
}

/** Return the frame of a hit at a column of the template. */
export function frameOfColumn(hit: FittedHit, column: number): number {
  const { columns, start } = hit;
  let best = 0;
  columns.forEach((one, i) => {
    if (Math.abs(one - column + 0.5) < Math.abs((columns[best] as number) - column + 0.5)) best = i;
  });
  return start + best;
}

function drawTemplate(canvas: HTMLCanvasElement, image: TemplateImage, features: readonly Feature[]): void {
  const theme = colours();
  canvas.width = image.columns;
  canvas.height = features.length * ROW;
  const pen = canvas.getContext("2d") as CanvasRenderingContext2D;
  pen.fillStyle = theme.raised;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  features.forEach((feature, row) => {
    pen.fillStyle = theme[sideOf(feature.name)];
    image.values[feature.bit]?.forEach((value, column) => {
      pen.globalAlpha = value;
      pen.fillRect(column, row * ROW, 1, ROW - 1);
    });
  });
  pen.globalAlpha = 1;
}
