// What is known about one hit: its motion, its cost along the take, the warping path, and what it contradicts.

import { Button, CloseButton, Group, Loader, Text, Title } from "@mantine/core";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { Link } from "wouter";

import { shownSeconds } from "../api/seconds";
import { takeAddress } from "../app/address";
import { Fault } from "../app/Fault";
import { Why } from "../label/Why";
import { SmallFigure } from "../motion/SmallFigure";
import { type Hit, type HitAnswer, type Known, keyOf } from "./types";
import type { Verdict } from "./verdicts";

export interface Explain {
  /** Changes with the question. */
  key: string;
  load: (hit: Hit, signal: AbortSignal) => Promise<HitAnswer>;
}

export interface DetailsProps {
  hit: Hit;
  rateHz: number;
  explain?: Explain;
  verdict: Verdict | undefined;
  /** Labels that the store has for its place. */
  known?: Known[];
  onVerdict: (verdict: Verdict | null) => void;
  onClose: () => void;
}

export function Details({ hit, rateHz, explain, verdict, known = [], onVerdict, onClose }: DetailsProps) {
  const seconds = (frame: number) => shownSeconds(frame, rateHz);
  const example = `/ask?take=${encodeURIComponent(hit.take)}&from=${hit.start}&to=${hit.stop}`;
  return (
    <aside className="details" aria-label="The chosen hit">
      <Group justify="space-between" wrap="nowrap">
        <Title order={2} style={{ overflowWrap: "anywhere" }}>
          {hit.take}
        </Title>
        <CloseButton aria-label="Close the details" onClick={onClose} />
      </Group>
      <Text size="sm">
        {seconds(hit.start)} to {seconds(hit.stop)} s, frames {hit.start} to {hit.stop}
        {hit.cost !== null && <>, cost {hit.cost.toFixed(4)}</>}
        {hit.mirrored && <>, as its mirror image</>}
      </Text>
      {known.length > 0 && (
        <Text size="sm">
          Labelled {known.map((one) => `${one.verdict === "negative" ? "not " : ""}${one.class}`).join(", ")}
        </Text>
      )}
      <SmallFigure item={hit} width={250} height={230} label={`The motion of ${hit.take}`} />
      <Group gap={6}>
        <Button
          size="compact-sm"
          variant={verdict === "yes" ? "filled" : "default"}
          aria-pressed={verdict === "yes"}
          onClick={() => onVerdict(verdict === "yes" ? null : "yes")}
        >
          ✓ Yes (y)
        </Button>
        <Button
          size="compact-sm"
          variant={verdict === "no" ? "filled" : "default"}
          aria-pressed={verdict === "no"}
          onClick={() => onVerdict(verdict === "no" ? null : "no")}
        >
          ✕ No (n)
        </Button>
        <Button size="compact-sm" variant="default" component={Link} href={takeAddress(hit.take, hit.start, hit.stop)}>
          Open the take
        </Button>
        <Button size="compact-sm" variant="default" component={Link} href={example}>
          Search by this
        </Button>
      </Group>
      {explain !== undefined && <Fit hit={hit} rateHz={rateHz} explain={explain} />}
      <Why key={keyOf(hit)} take_id={hit.take_id} start={hit.start} stop={hit.stop} />
    </aside>
  );
}

function Fit({ hit, rateHz, explain }: { hit: Hit; rateHz: number; explain: Explain }) {
  const fit = useQuery({
    queryKey: ["version", "ask-hit", explain.key, keyOf(hit)],
    queryFn: ({ signal }) => explain.load(hit, signal),
    placeholderData: keepPreviousData,
  });
  if (fit.isError) return <Fault fault={fit.error} retry={() => void fit.refetch()} />;
  if (fit.data === undefined) return <Loader size="sm" aria-label="The curve is being computed" />;
  const { contradicted } = fit.data;
  return (
    <>
      <FitCurve fit={fit.data} hit={hit} rateHz={rateHz} />
      <FitPath fit={fit.data} hit={hit} />
      <Text size="sm" fw={600} mt={6}>
        {contradicted.length === 0 ? "No feature contradicts the example." : "What differs from the example"}
      </Text>
      {contradicted.length > 0 && (
        <ul className="contradicted">
          {contradicted.slice(0, 8).map((one) => (
            <li key={one.feature}>
              <meter min={0} max={1} value={one.share} aria-label={one.feature} /> {one.feature}{" "}
              <span className="muted">{(100 * one.share).toFixed(0)} % of the frames</span>
            </li>
          ))}
        </ul>
      )}
    </>
  );
}

const WIDTH = 280;
const HEIGHT = 84;

export function FitCurve({ fit, hit, rateHz }: { fit: HitAnswer; hit: Hit; rateHz: number }) {
  const frames = fit.curve.length;
  const most = Math.max(2 * fit.tau, ...fit.curve.map((cost) => cost ?? 0));
  const x = (frame: number) => ((frame - fit.first) / Math.max(1, frames - 1)) * WIDTH;
  const y = (cost: number) => HEIGHT - (cost / most) * (HEIGHT - 4) - 2;
  let line = "";
  let open = false;
  fit.curve.forEach((cost, i) => {
    if (cost !== null) line += `${open ? "L" : "M"}${x(fit.first + i).toFixed(1)} ${y(cost).toFixed(1)}`;
    open = cost !== null;
  });
  const label = `Distance to the example from ${shownSeconds(fit.first, rateHz, 1)} s on; least ${fit.cost?.toFixed(3) ?? ""} at the end of the hit; threshold ${fit.tau}`;
  return (
    <figure className="plot">
      <figcaption>Distance, and τ</figcaption>
      <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={label}>
        <rect x={x(fit.start)} width={Math.max(1, x(hit.stop - 1) - x(fit.start))} height={HEIGHT} className="plot-hit" />
        <line x1={0} x2={WIDTH} y1={y(fit.tau)} y2={y(fit.tau)} className="plot-tau" />
        <path d={line} className="plot-line" />
        {fit.cost !== null && <circle cx={x(hit.stop - 1)} cy={y(fit.cost)} r={3.5} className="plot-end" />}
      </svg>
    </figure>
  );
}

export function FitPath({ fit, hit }: { fit: HitAnswer; hit: Hit }) {
  if (fit.columns.length < 2) return null;
  const frames = hit.stop - fit.start - 1;
  const points = fit.columns
    .map((column, i) => `${((i / Math.max(1, frames)) * WIDTH).toFixed(1)} ${(60 - (column / Math.max(1, fit.template_columns - 1)) * 58).toFixed(1)}`)
    .join(" ");
  return (
    <figure className="plot">
      <figcaption>Warping path: time of the hit to the right, of the example upwards</figcaption>
      <svg viewBox={`0 0 ${WIDTH} 62`} role="img" aria-label="The warping path of the hit">
        <line x1={0} y1={60} x2={WIDTH} y2={2} className="plot-tau" />
        <polyline points={points} className="plot-line" />
      </svg>
    </figure>
  );
}
