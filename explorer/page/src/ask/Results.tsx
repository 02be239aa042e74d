// A grid of looping hits. Arrow keys move between them, y accepts, n rejects, Space leaves one undecided; each goes on
// to the next that is undecided. Enter opens the take. What was said of the place of a hit before is marked on it: by a
// verdict on the hits of an earlier question, or by a label of the store. The pointer shows how a hit fits.

import { useQuery } from "@tanstack/react-query";
import { memo, useCallback, useEffect, useMemo, useRef, useState } from "react";
import { useLocation } from "wouter";

import { post } from "../api/client";
import { shownSeconds } from "../api/seconds";
import { takeAddress, useParameter } from "../app/address";
import { useShortcuts } from "../app/shortcuts";
import { SmallFigure } from "../motion/SmallFigure";
import { Details, type Explain } from "./Details";
import { FitPreview } from "./FitPreview";
import { asked, type Hit, type Interval, type Known, keyOf, samePlace } from "./types";
import { type Mark, useVerdicts, type Verdict } from "./verdicts";

export interface ResultsProps {
  hits: readonly Hit[];
  rateHz: number;
  /** True while hits are those of an earlier question. */
  old?: boolean;
  /** Answers how a hit fits; without it details show the hit alone. */
  explain?: Explain;
  /** What was asked for; hits of its places are named so. */
  examples?: readonly Interval[];
}

const NO_EXAMPLES: readonly Interval[] = [];

export function Results({ hits, rateHz, old = false, explain, examples = NO_EXAMPLES }: ResultsProps) {
  const verdicts = useVerdicts();
  const [, navigate] = useLocation();
  const [wanted] = useParameter("class");
  const [place, setPlace] = useState(-1);
  const [pointed, setPointed] = useState<{ hit: Hit; cell: HTMLElement } | null>(null);
  const grid = useRef<HTMLDivElement>(null);
  const labels = useLabels(hits);
  const at = Math.min(place, hits.length - 1);
  const chosen = hits[at];
  const line = hits.findIndex((one) => one.probable === false);

  const go = useCallback((next: number) => {
    const cells = grid.current?.querySelectorAll<HTMLElement>(".hit");
    if (cells === undefined || cells.length === 0) return;
    const to = Math.max(0, Math.min(cells.length - 1, next));
    setPlace(to);
    cells[to]?.focus();
  }, []);
  const isDecided = (hit: Hit, i: number) =>
    verdicts.of(hit) !== undefined || (labels?.[i] ?? []).some((one) => one.class === wanted);
  const decide = (verdict: Verdict | null) => {
    if (chosen === undefined) return go(0);
    verdicts.set(chosen, verdict);
    const next = hits.findIndex((hit, i) => i > at && !samePlace(hit, chosen) && !isDecided(hit, i));
    go(next < 0 ? at + 1 : next);
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
  useEffect(() => setPointed(null), [hits, explain]);
  const point = useCallback((hit: Hit | null, cell: HTMLElement | null) => {
    setPointed(hit === null || cell === null ? null : { hit, cell });
  }, []);

  return (
    <div className="hits-and-details">
      <div
        ref={grid}
        className="hits"
        role="listbox"
        aria-label="Hits, the best first"
        aria-busy={old}
        data-old={old}
        onPointerLeave={() => setPointed(null)}
      >
        {hits.map((hit, i) => {
          const mark = verdicts.of(hit);
          const cell = (
            <Cell
              key={keyOf(hit)}
              hit={hit}
              place={i}
              rateHz={rateHz}
              verdict={mark?.verdict}
              earlier={mark?.earlier === true}
              known={labels?.[i]}
              example={examples.some((one) => samePlace(one, hit))}
              chosen={i === at}
              first={i === Math.max(at, 0)}
              onChoose={setPlace}
              onPoint={explain === undefined ? undefined : point}
            />
          );
          if (i !== line) return cell;
          return [
            <div key="line" className="hits-line muted" role="presentation">
              probably other motions
            </div>,
            cell,
          ];
        })}
        {pointed !== null && explain !== undefined && pointed.hit !== chosen && (
          <FitPreview key={keyOf(pointed.hit)} hit={pointed.hit} cell={pointed.cell} rateHz={rateHz} explain={explain} />
        )}
      </div>
      {chosen !== undefined && (
        <Details
          hit={chosen}
          rateHz={rateHz}
          explain={explain}
          verdict={verdicts.of(chosen)?.verdict}
          known={labels?.[at]}
          onVerdict={(verdict) => verdicts.set(chosen, verdict)}
          onClose={() => setPlace(-1)}
        />
      )}
    </div>
  );
}

/** Return the labels that the store has for each hit, once they are known. */
function useLabels(hits: readonly Hit[]): Known[][] | undefined {
  const places = useMemo(() => hits.map(asked), [hits]);
  const found = useQuery({
    queryKey: ["labels", "ask-labelled", places],
    queryFn: ({ signal }) => post<{ labels: Known[][] }>("/api/ask/labelled", { hits: places }, signal),
    enabled: places.length > 0,
  });
  return found.data?.labels;
}

/** Return what a mark or a label says, as text: "✓ yes", "✕ wave". */
export function markText(mark: Pick<Mark, "verdict">): string {
  return mark.verdict === "yes" ? "✓ yes" : "✕ no";
}

export function knownText(one: Known): string {
  return `${one.verdict === "negative" ? "✕" : "✓"} ${one.class}`;
}

interface CellProps {
  hit: Hit;
  place: number;
  rateHz: number;
  verdict: Verdict | undefined;
  earlier: boolean;
  known: Known[] | undefined;
  example: boolean;
  chosen: boolean;
  first: boolean;
  onChoose: (place: number) => void;
  onPoint: ((hit: Hit, cell: HTMLElement) => void) | undefined;
}

const Cell = memo(function Cell(props: CellProps) {
  const { hit, place, rateHz, verdict, earlier, known = [], example, chosen, first, onChoose, onPoint } = props;
  const number = hit.similarity != null ? hit.similarity.toFixed(2) : hit.cost === null ? `${place + 1}` : hit.cost.toFixed(3);
  const marks = [
    hit.mirrored ? "mirror" : "",
    verdict === undefined ? "" : markText({ verdict }),
    known.map(knownText).join(", "),
  ];
  // what a screen reader says holds what is shown, in this order
  const shown = [number, ...marks, hit.take, example ? "example" : ""].filter((one) => one !== "").join(" ");
  const other = hit.probable === false ? ", probably another motion" : "";
  const at = `at ${shownSeconds(hit.start, rateHz, 1)} s${earlier ? ", decided with other ends" : ""}${other}`;
  return (
    <div
      className="hit"
      role="option"
      aria-selected={chosen}
      aria-label={`${place + 1}: ${shown}, ${at}`}
      tabIndex={first ? 0 : -1}
      data-verdict={verdict}
      data-earlier={earlier}
      onClick={() => onChoose(place)}
      onFocus={() => onChoose(place)}
      onPointerEnter={(event) => event.pointerType === "mouse" && onPoint?.(hit, event.currentTarget)}
      title={onPoint === undefined ? `${hit.take}, frames ${hit.start} to ${hit.stop}` : undefined}
    >
      <SmallFigure item={hit} width={104} height={112} />
      <span className="hit-facts">
        <span className="hit-cost">{number}</span> {hit.mirrored && <span className="muted">mirror</span>}{" "}
        {verdict !== undefined && <b className={`hit-${verdict}`}>{markText({ verdict })}</b>}
      </span>{" "}
      {known.length > 0 && <span className="hit-known">{known.map(knownText).join(", ")}</span>}{" "}
      <span className="hit-name muted">{hit.take}</span> {example && <span className="hit-example">example</span>}
    </div>
  );
});
