// The clips behind a template as moving figures, those far from the others first.

import { Button, Text } from "@mantine/core";
import { useState } from "react";
import { Link } from "wouter";

import { shownSeconds } from "../api/seconds";
import { takeAddress } from "../app/address";
import { SmallFigure } from "../motion/SmallFigure";
import { spreadsAbove } from "./edits";
import type { Clip, TemplateFacts } from "./types";

const FIRST = 24;

export interface ClipsProps {
  facts: TemplateFacts;
  rateHz: number;
  /** The name of the clip whose poses are shown. */
  shown: string | null;
  onShow: (clip: Clip) => void;
}

export function Clips({ facts, rateHz, shown, onShow }: ClipsProps) {
  const [all, setAll] = useState(false);
  const { clips, far } = facts;
  const apart = clips.filter((one) => one.far).length;
  return (
    <section aria-label="Clips">
      <h3>
        {clips.length} {clips.length === 1 ? "clip" : "clips"} behind it{far === null ? "" : `, ${apart} far from the rest`}
      </h3>
      {clips.length > 0 && (
        <Text size="sm" className="muted templates-text">
          {far === null ? (
            "The cost to the others needs four clips and more to tell which are far from the rest. "
          ) : (
            <>
              The cost of a clip to the others is the median of its costs to each of them, before any averaging. A clip is far from the rest from{" "}
              {far.limit.toFixed(3)} on: 1.5 times the median of all clips ({far.median.toFixed(3)}), 5 spreads above it (the spread is the median distance
              from the median, {far.spread.toFixed(3)}), and 0.05 above it.{" "}
            </>
          )}
          The cost to the template is its least distance within the clip, as τ is compared with; the clip helped to make the template.
        </Text>
      )}
      {facts.missing > 0 && (
        <Text size="sm" className="templates-remark">
          {facts.missing} of its clips are not in the store any more.
        </Text>
      )}
      <ul className="clips">
        {(all ? clips : clips.slice(0, FIRST)).map((one) => (
          <li key={`${one.name}${one.mirrored ? " mirrored" : ""}`} className="clip" data-far={one.far}>
            <Link href={takeAddress(one.take, one.start, one.stop)} title={`${one.take}, frames ${one.start} to ${one.stop}: open the take`}>
              <SmallFigure item={one} width={104} height={108} />
              <span className="clip-name">{one.name}</span>
            </Link>
            <span>
              {one.to_others === null ? "" : `to the others ${one.to_others.toFixed(3)}`}
              {one.to_others !== null && far !== null && <Spreads cost={one.to_others} far={far} />}
            </span>
            <span className="muted">
              to the template {one.to_template === null ? "too short" : one.to_template.toFixed(3)}; {shownSeconds(one.stop - one.start, rateHz)} s
            </span>
            {one.far && <b className="templates-remark">far from the rest</b>}
            {one.mirrored && <span className="muted">in the mirror</span>}
            {one.frames !== null && (
              <button type="button" className="templates-plain" aria-pressed={one.name === shown} onClick={() => onShow(one)}>
                {one.name === shown ? "its poses are shown" : "show its poses"}
              </button>
            )}
          </li>
        ))}
      </ul>
      {!all && clips.length > FIRST && (
        <Button size="compact-sm" variant="default" onClick={() => setAll(true)}>
          Show all {clips.length} clips
        </Button>
      )}
    </section>
  );
}

function Spreads({ cost, far }: { cost: number; far: { median: number; spread: number } }) {
  const above = spreadsAbove(cost, far);
  if (above === null) return null;
  return <span className="muted"> ({above < 0 ? "−" : "+"}{Math.abs(above).toFixed(1)} spreads)</span>;
}
