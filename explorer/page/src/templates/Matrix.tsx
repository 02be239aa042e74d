// A template large: its features by group, with the weight of each and the columns that are kept. Hovering, or the arrow
// keys, point at a column and a feature.

import { RangeSlider } from "@mantine/core";
import { useElementSize } from "@mantine/hooks";
import { type KeyboardEvent, memo, type PointerEvent, useEffect, useMemo, useRef } from "react";

import type { Feature } from "../api/types";
import { grouped } from "../ask/poses";
import { onTheme } from "../motion/colours";
import { drawMatrix } from "./draw";
import { type Edits, MAX_WEIGHT, weightAfter } from "./edits";
import type { TemplateFacts } from "./types";

const ROW = 17;

export interface Place {
  column: number;
  bit: number;
}

export interface MatrixProps {
  facts: TemplateFacts;
  features: readonly Feature[];
  edits: Edits;
  at: Place | null;
  onAt: (place: Place | null) => void;
  onWeight: (feature: string, weight: number) => void;
  onColumns: (first: number, stop: number) => void;
}

export function Matrix({ facts, features, edits, at, onAt, onWeight, onColumns }: MatrixProps) {
  const { ref, width } = useElementSize();
  const groups = useMemo(() => grouped(features), [features]);
  const order = useMemo(() => groups.flatMap(([, own]) => own.map((one) => one.bit)), [groups]);
  const onKeyDown = (event: KeyboardEvent) => {
    const pointed = features.find((one) => one.bit === at?.bit);
    const changed = pointed === undefined ? null : weightAfter(event.key, edits.weights[pointed.name] ?? 1);
    if (pointed !== undefined && changed !== null) {
      event.preventDefault();
      onWeight(pointed.name, changed);
      return;
    }
    const steps: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[event.key];
    if (step === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    const place = at === null ? 0 : order.indexOf(at.bit) + step[1];
    const column = at === null ? edits.first : at.column + step[0];
    onAt({
      column: Math.max(0, Math.min(facts.columns - 1, column)),
      bit: order[Math.max(0, Math.min(order.length - 1, place))] as number,
    });
  };
  return (
    <div className="matrix">
      <div className="matrix-row">
        <span className="muted matrix-cut">columns kept</span>
        <RangeSlider
          size="sm"
          min={0}
          max={facts.columns}
          step={1}
          minRange={1}
          value={[edits.first, edits.stop]}
          onChange={([first, stop]) => onColumns(first, stop)}
          label={(value) => `${value} of ${facts.columns}`}
          thumbFromLabel="First column that is kept"
          thumbToLabel="End of the columns that are kept"
        />
        <span className="muted matrix-cut">weight</span>
      </div>
      <div
        className="matrix-keys"
        tabIndex={0}
        role="application"
        aria-label={`The template ${facts.name}: ${features.length} features in ${facts.columns} columns. Arrow keys move from column to column and from feature to feature; x turns the feature off and on, plus and minus change its weight.`}
        onKeyDown={onKeyDown}
      >
        <div className="matrix-row" aria-hidden>
          <span />
          <span ref={ref} />
          <span />
        </div>
        {groups.map(([group, own]) => (
          <Rows
            key={group}
            group={group}
            features={own}
            facts={facts}
            edits={edits}
            width={width}
            at={at !== null && own.some((one) => one.bit === at.bit) ? at : null}
            column={at?.column ?? null}
            onAt={onAt}
          />
        ))}
      </div>
      <Weights groups={groups} facts={facts} edits={edits} onWeight={onWeight} />
    </div>
  );
}

interface RowsProps {
  group: string;
  features: readonly Feature[];
  facts: TemplateFacts;
  edits: Edits;
  width: number;
  at: Place | null;
  column: number | null;
  onAt: (place: Place | null) => void;
}

function Rows({ group, features, facts, edits, width, at, column, onAt }: RowsProps) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const { weights, first, stop } = edits;
  useEffect(() => {
    const shown = canvas.current;
    if (shown === null || width === 0) return;
    const counts = new Map(features.map((one) => [one.bit, (weights[one.name] ?? 1) * (facts.weights?.[one.bit] ?? 1) > 0]));
    const look = {
      order: features.map((one) => one.bit),
      row: ROW,
      column: width / facts.columns,
      counts: (bit: number, place: number) => counts.get(bit) === true && place >= first && place < stop,
    };
    const draw = () => drawMatrix(shown, facts.values, look);
    draw();
    return onTheme(draw);
  }, [facts, features, width, weights, first, stop]);
  const onPointerMove = (event: PointerEvent) => {
    const box = event.currentTarget.getBoundingClientRect();
    const place = (size: number, from: number, whole: number) => Math.max(0, Math.min(size - 1, Math.floor((from / whole) * size)));
    const feature = features[place(features.length, event.clientY - box.top, box.height)] as Feature;
    onAt({ column: place(facts.columns, event.clientX - box.left, box.width), bit: feature.bit });
  };
  const here = at === null ? -1 : features.findIndex((one) => one.bit === at.bit);
  const share = 100 / facts.columns;
  return (
    <div className="matrix-group">
      <span className="matrix-title muted">{group}</span>
      <div className="matrix-row">
        <div className="matrix-names" aria-hidden>
          {features.map((one, i) => (
            <span key={one.bit} className="matrix-name" data-here={i === here} data-off={weights[one.name] === 0} title={one.description}>
              {one.name}
            </span>
          ))}
        </div>
        <div className="matrix-image" onPointerMove={onPointerMove} onPointerLeave={() => onAt(null)}>
          <canvas ref={canvas} role="presentation" style={{ width: "100%", height: features.length * ROW }} />
          {column !== null && <div className="matrix-column" style={{ left: `${column * share}%`, width: `${share}%` }} />}
          {here >= 0 && <div className="matrix-feature" style={{ top: here * ROW, height: ROW - 1 }} />}
        </div>
      </div>
    </div>
  );
}

interface WeightsProps {
  groups: [string, Feature[]][];
  facts: TemplateFacts;
  edits: Edits;
  onWeight: (feature: string, weight: number) => void;
}

/** The weight of each feature beside its row: a field, and a button that turns it off and on. */
const Weights = memo(function Weights({ groups, facts, edits, onWeight }: WeightsProps) {
  return (
    <div className="matrix-weights" role="group" aria-label="Weights of features">
      {groups.map(([group, own]) => (
        <div key={group} className="matrix-group">
          <span className="matrix-title" aria-hidden />
          {own.map((one) => {
            const weight = edits.weights[one.name] ?? 1;
            const learned = facts.weights?.[one.bit] ?? 1;
            return (
              <span key={one.bit} className="matrix-weight" style={{ height: ROW }}>
                <input
                  type="number"
                  min={0}
                  max={MAX_WEIGHT}
                  step={0.5}
                  aria-label={`Weight of ${one.name}`}
                  title={learned === 1 ? undefined : `times its learned weight, ${learned}`}
                  value={weight}
                  data-changed={weight !== 1}
                  onChange={(event) => {
                    const next = event.currentTarget.valueAsNumber;
                    if (next >= 0 && next <= MAX_WEIGHT) onWeight(one.name, next);
                  }}
                />
                <button
                  type="button"
                  tabIndex={-1}
                  aria-pressed={weight === 0}
                  aria-label={`${one.name} off`}
                  title={weight === 0 ? "Let it count again" : "Turn it off"}
                  onClick={() => onWeight(one.name, weight === 0 ? 1 : 0)}
                >
                  ✕
                </button>
              </span>
            );
          })}
        </div>
      ))}
    </div>
  );
});
