// A grid of looping hits. Arrow keys move between them, y accepts, n rejects, Space leaves one undecided; each goes on
// to the next. Enter opens the take.

import { memo, useCallback, useEffect, useRef, useState } from "react";
import { useLocation } from "wouter";

import { takeAddress } from "../app/address";
import { useShortcuts } from "../app/shortcuts";
import { SmallFigure } from "../motion/SmallFigure";
import { Details, type Explain } from "./Details";
import { type Hit, keyOf } from "./types";
import { useVerdicts, type Verdict } from "./verdicts";

export interface ResultsProps {
  hits: readonly Hit[];
  rateHz: number;
  /** True while hits are those of an earlier question. */
  old?: boolean;
  /** Answers how a hit fits; without it details show the hit alone. */
  explain?: Explain;
}

export function Results({ hits, rateHz, old = false, explain }: ResultsProps) {
  const verdicts = useVerdicts();
  const [, navigate] = useLocation();
  const [place, setPlace] = useState(-1);
  const grid = useRef<HTMLDivElement>(null);
  const at = Math.min(place, hits.length - 1);
  const chosen = hits[at];

  const go = useCallback((next: number) => {
    const cells = grid.current?.querySelectorAll<HTMLElement>(".hit");
    if (cells === undefined || cells.length === 0) return;
    const to = Math.max(0, Math.min(cells.length - 1, next));
    setPlace(to);
    cells[to]?.focus();
  }, []);
  const decide = (verdict: Verdict | null) => {
    if (chosen === undefined) return go(0);
    verdicts.set(chosen, verdicts.of(chosen) === verdict ? null : verdict);
    go(at + 1);
  };
  const columns = () => {
    const cells = grid.current?.querySelectorAll<HTMLElement>(".hit") ?? [];
    const top = cells[0]?.offsetTop;
    return Math.max(1, [...cells].findIndex((cell) => cell.offsetTop !== top));
  };
  const inGrid = (run: () => void) => (event: KeyboardEvent) => {
    if (document.activeElement === document.body || grid.current?.contains(event.target as Node) === true) run();
  };
  useShortcuts("Hits", [
    { keys: "y", what: "Accept the hit", run: () => decide("yes") },
    { keys: "n", what: "Reject the hit", run: () => decide("no") },
    { keys: " ", what: "Leave the hit undecided", run: inGrid(() => decide(null)) },
    { keys: "ArrowRight", what: "Next hit", run: inGrid(() => go(at + 1)) },
    { keys: "ArrowLeft", what: "Hit before", run: inGrid(() => go(at - 1)) },
    { keys: "ArrowDown", what: "Hit below", run: inGrid(() => go(at < 0 ? 0 : at + columns())) },
    { keys: "ArrowUp", what: "Hit above", run: inGrid(() => go(at - columns())) },
    {
      keys: "Enter",
      what: "Open the take of the hit",
      run: inGrid(() => chosen !== undefined && navigate(takeAddress(chosen.take, chosen.start, chosen.stop))),
    },
  ]);
  useEffect(() => setPlace((before) => Math.min(before, hits.length - 1)), [hits]);

  return (
    <div className="hits-and-details">
      <div ref={grid} className="hits" role="listbox" aria-label="Hits, the best first" aria-busy={old} data-old={old}>
        {hits.map((hit, i) => (
          <Cell
            key={keyOf(hit)}
            hit={hit}
            place={i}
            rateHz={rateHz}
            verdict={verdicts.of(hit)}
            chosen={i === at}
            first={i === Math.max(at, 0)}
            onChoose={setPlace}
          />
        ))}
      </div>
      {chosen !== undefined && (
        <Details
          hit={chosen}
          rateHz={rateHz}
          explain={explain}
          verdict={verdicts.of(chosen)}
          onVerdict={(verdict) => verdicts.set(chosen, verdict)}
          onClose={() => setPlace(-1)}
        />
      )}
    </div>
  );
}

interface CellProps {
  hit: Hit;
  place: number;
  rateHz: number;
  verdict: Verdict | undefined;
  chosen: boolean;
  first: boolean;
  onChoose: (place: number) => void;
}

const Cell = memo(function Cell({ hit, place, rateHz, verdict, chosen, first, onChoose }: CellProps) {
  const at = (hit.start / rateHz).toFixed(1);
  const state = verdict === "yes" ? ", accepted" : verdict === "no" ? ", rejected" : "";
  const cost = hit.cost === null ? "" : `, cost ${hit.cost.toFixed(3)}`;
  return (
    <div
      className="hit"
      role="option"
      aria-selected={chosen}
      aria-label={`${place + 1}: ${hit.take} at ${at} s${cost}${hit.mirrored ? ", mirrored" : ""}${state}`}
      tabIndex={first ? 0 : -1}
      data-verdict={verdict}
      onClick={() => onChoose(place)}
      onFocus={() => onChoose(place)}
      title={`${hit.take}, frames ${hit.start} to ${hit.stop}`}
    >
      <SmallFigure item={hit} width={104} height={112} />
      <span className="hit-facts">
        <span className="hit-cost">{hit.cost === null ? `${place + 1}` : hit.cost.toFixed(3)}</span>
        {hit.mirrored && <span className="muted">mirror</span>}
        {verdict !== undefined && <b className={`hit-${verdict}`}>{verdict === "yes" ? "✓ yes" : "✕ no"}</b>}
      </span>
      <span className="hit-name muted">{hit.take}</span>
    </div>
  );
});
