// How well each threshold divides the training clips of a class from those of all others.

import { Text } from "@mantine/core";

import type { Divided } from "./types";

const WIDTH = 420;
const HEIGHT = 90;
const FOOT = 16;

export interface ThresholdCurveProps {
  training: Divided;
  used: number;
  pipeline: number;
  name: string;
  advice: string | null;
}

/** F of the training clips over τ, with the τ that is used and the best one. */
export function ThresholdCurve({ training, used, pipeline, name, advice }: ThresholdCurveProps) {
  const most = Math.max(used, pipeline, 2 * training.tau);
  const x = (tau: number) => Math.min(tau / most, 1) * WIDTH;
  const y = (score: number) => 2 + (1 - score) * (HEIGHT - FOOT - 4);
  const steps = training.taus.map((tau, place) => ` H ${x(tau).toFixed(1)} V ${y(training.scores[place] ?? 0).toFixed(1)}`);
  const now = scoreAt(training, used);
  const facts = `τ = ${used.toFixed(3)} has F ${now.toFixed(3)}, the best one, ${training.tau.toFixed(3)}, has ${training.f.toFixed(3)}`;
  return (
    <figure className="effect-curve">
      <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={`F of the training clips over τ: ${facts}`}>
        <path className="effect-curve-line" d={`M 0 ${y(0)}${steps.join("")} H ${WIDTH}`} />
        <line className="effect-curve-best" x1={x(training.tau)} x2={x(training.tau)} y1={0} y2={HEIGHT - FOOT} />
        <line className="effect-curve-used" x1={x(used)} x2={x(used)} y1={0} y2={HEIGHT - FOOT} />
        <text x={0} y={HEIGHT - 3}>
          τ = 0
        </text>
        <text x={WIDTH} y={HEIGHT - 3} textAnchor="end">
          {most.toFixed(3)}
        </text>
      </svg>
      <Text component="figcaption" size="xs" className="muted">
        Training clips of {name} and of all other classes: {facts}.
        {advice !== null && (
          <>
            {" "}
            A run of the pipeline with <code className="effect-setting">{advice}</code> gives each class a threshold of its own.
          </>
        )}
      </Text>
    </figure>
  );
}

/** Return F at a threshold. */
export function scoreAt({ taus, scores }: Divided, tau: number): number {
  // a clip counts below τ, so that a distance of exactly τ does not
  const place = taus.findLastIndex((one) => one < tau);
  return place < 0 ? 0 : (scores[place] ?? 0);
}
