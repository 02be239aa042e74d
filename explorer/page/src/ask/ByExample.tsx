// Search by example: the interval of the address, or several accepted hits, in contrast to rejected ones.

import { Button, Group, NumberInput, RangeSlider, Switch, Text } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useState } from "react";
import { Link } from "wouter";

import { post } from "../api/client";
import { shownSeconds } from "../api/seconds";
import type { StoreFacts } from "../api/types";
import { takeAddress, useJsonParameter, useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useSelection } from "../archive/selection";
import { counted, hours } from "../archive/text";
import { SmallFigure } from "../motion/SmallFigure";
import type { Explain } from "./Details";
import { Results } from "./Results";
import { SaveBar } from "./SaveBar";
import { TakeName, useNamedTakes } from "./TakeName";
import {
  asked,
  type ExamplesAnswer,
  type ExamplesQuestion,
  type Hit,
  type HitAnswer,
  type Interval,
  type Packed,
  packed,
  samePlace,
  unpacked,
} from "./types";

const NONE: Packed[] = [];
const TAU = 0.5;
const TOP = 60;
const MOST = 500;

export function ByExample({ store }: { store: StoreFacts }) {
  const question = useQuestion();
  const top = question?.top ?? TOP;
  const set = useParameters();
  const body = useMemo(() => JSON.stringify(question), [question]);
  const [settled] = useDebouncedValue(body, 150);
  const answer = useQuery({
    queryKey: ["version", "ask-examples", settled],
    queryFn: ({ signal }) => post<ExamplesAnswer>("/api/ask/examples", JSON.parse(settled), signal),
    enabled: settled !== "null",
    placeholderData: keepPreviousData,
  });
  useSame(answer.data);
  const explain = useMemo<Explain | undefined>(
    () =>
      settled === "null"
        ? undefined
        : {
            key: settled,
            load: (hit, signal) =>
              post<HitAnswer>("/api/ask/hit", { ...(JSON.parse(settled) as object), hit: asked(hit) }, signal),
          },
    [settled],
  );
  const [origin] = useParameter("of");
  const refine = (accepted: Interval[], rejected: Interval[]) => {
    const [first] = question?.positives ?? [];
    const example = question?.positives.filter((one) => !accepted.some((other) => samePlace(one, other))) ?? [];
    set(
      {
        more: JSON.stringify([...example, ...accepted].map(packed)),
        less: rejected.length === 0 ? null : JSON.stringify(rejected.map(packed)),
        of: origin ?? (first === undefined ? null : [first.take, first.start, first.stop].join(" ")),
        take: null,
        from: null,
        to: null,
      },
      true,
    );
  };
  if (question === null) return <Chooser store={store} />;
  const found = answer.data;
  const old = answer.isPlaceholderData || answer.isFetching;
  return (
    <div className="ask-body">
      <section className="question" aria-label="The example">
        <Examples question={question} store={store} />
        <Options mirror={question.mirror} tau={question.tau} />
        {found !== undefined && <Remarks found={found} />}
      </section>
      <section className="answer" aria-label="Hits">
        {answer.isError && <Fault fault={answer.error} retry={() => void answer.refetch()} />}
        {found !== undefined && (
          <>
            <Text size="sm" role="status" aria-live="polite">
              {found.more ? `the ${found.total} most similar places` : counted(found.total, "place")} in {hours(found.hours)},{" "}
              {probable(found.hits)} <span className="muted">· {(1000 * found.seconds).toFixed(0)} ms</span>
              {old && <span className="muted"> · searching…</span>}
            </Text>
            <SaveBar hits={found.hits} examples={question.positives} onRefine={refine} />
            <Results
              hits={found.hits}
              rateHz={store.rate_hz}
              old={old}
              explain={explain}
              examples={question.positives}
            />
            {found.more && top < MOST && (
              <Button
                size="compact-sm"
                variant="default"
                onClick={() => set({ top: String(Math.min(MOST, 2 * top)) })}
              >
                Show more hits
              </Button>
            )}
          </>
        )}
        {found === undefined && !answer.isError && (
          <Text size="sm" role="status">
            Searching {store.hours.toFixed(1)} hours…
          </Text>
        )}
      </section>
    </div>
  );
}

/** Return what the address asks for, null where it names no example. */
function useQuestion(): ExamplesQuestion | null {
  const [take] = useParameter("take");
  const [from] = useParameter("from");
  const [to] = useParameter("to");
  const [more] = useJsonParameter<Packed[]>("more", NONE);
  const [less] = useJsonParameter<Packed[]>("less", NONE);
  const [tau] = useParameter("tau");
  const [top] = useParameter("top");
  const [mirror] = useParameter("mirror");
  const { filters, where } = useSelection();
  return useMemo(() => {
    const start = Math.max(0, Number(from));
    const stop = Number(to);
    const own = take !== null && to !== null && Number.isInteger(start) && Number.isInteger(stop) && stop > start;
    const positives = [...(own ? [{ take, start, stop, mirrored: false }] : []), ...unpacked(more)];
    if (positives.length === 0) return null;
    return {
      positives,
      negatives: unpacked(less),
      mirror: mirror !== "no",
      tau: bounded(tau, 0.001, 1, TAU),
      top: Math.round(bounded(top, 1, MOST, TOP)),
      ...(where === null ? {} : { where }),
      ...(filters.length === 0 ? {} : { filters }),
    };
  }, [take, from, to, more, less, tau, top, mirror, where, filters]);
}

/** Return how many of the hits probably show the motion, as text. */
function probable(hits: readonly Hit[]): string {
  const count = hits.filter((one) => one.probable === true).length;
  return count === 0 ? "none of them probable" : `${count} of them probable`;
}

function bounded(text: string | null, least: number, most: number, absent: number): number {
  const value = text === null ? Number.NaN : Number(text);
  return Number.isFinite(value) ? Math.min(most, Math.max(least, value)) : absent;
}

function Options({ mirror, tau }: { mirror: boolean; tau: number }) {
  const set = useParameters();
  return (
    <Group gap={12} mt="xs">
      <NumberInput
        size="xs"
        w={120}
        label="τ, largest cost"
        value={tau}
        min={0.01}
        max={1}
        step={0.01}
        decimalScale={3}
        onChange={(value) => typeof value === "number" && value > 0 && set({ tau: value === TAU ? null : String(value) })}
      />
      <Switch
        mt={16}
        size="xs"
        label="mirror images, too"
        checked={mirror}
        onChange={(event) => set({ mirror: event.currentTarget.checked ? null : "no" })}
      />
    </Group>
  );
}

function Examples({ question, store }: { question: ExamplesQuestion; store: StoreFacts }) {
  const set = useParameters();
  const [origin] = useParameter("of");
  const [take] = useParameter("take");
  const [from] = useParameter("from");
  const [to] = useParameter("to");
  const takes = useNamedTakes([...question.positives, ...question.negatives].map((one) => one.take));
  const keep = (positives: Interval[], negatives: Interval[]) =>
    set({
      more: JSON.stringify(positives.map(packed)),
      less: negatives.length === 0 ? null : JSON.stringify(negatives.map(packed)),
      of: origin ?? (take === null ? null : [take, from, to].join(" ")),
      take: null,
      from: null,
      to: null,
    });
  const { positives, negatives } = question;
  const [first] = positives;
  const length = takes?.get(first?.take ?? "")?.frames;
  const row = (one: Interval, without: () => void, key: number) => (
    <li key={key}>
      {takes?.has(one.take) === true && (
        <SmallFigure
          item={{ take_id: takes.get(one.take)?.id ?? -1, start: one.start, stop: one.stop }}
          width={positives.length > 1 ? 56 : 150}
          height={positives.length > 1 ? 62 : 160}
        />
      )}
      <span>
        <Link href={takeAddress(one.take, one.start, one.stop)}>{one.take}</Link>
        <br />
        <span className="muted">
          {shownSeconds(one.start, store.rate_hz)} to {shownSeconds(one.stop, store.rate_hz)} s
          {one.mirrored ? ", mirrored" : ""}
        </span>
        {positives.length + negatives.length > 1 && (
          <>
            <br />
            <button type="button" className="plain" onClick={without}>
              remove
            </button>
          </>
        )}
      </span>
    </li>
  );
  return (
    <>
      <h2>{positives.length > 1 ? `More like these ${positives.length}` : "Like this"}</h2>
      <ul className="examples">
        {positives.map((one, i) =>
          row(one, () => keep(positives.filter((_, j) => j !== i), negatives), i),
        )}
      </ul>
      {first !== undefined && length !== undefined && positives.length + negatives.length === 1 && (
        <Ends key={first.take} interval={first} frames={length} rateHz={store.rate_hz} />
      )}
      {negatives.length > 0 && (
        <>
          <h2>Less like these {negatives.length}</h2>
          <ul className="examples">
            {negatives.map((one, i) => row(one, () => keep(positives, negatives.filter((_, j) => j !== i)), i))}
          </ul>
        </>
      )}
    </>
  );
}

/** The two ends of the example, to be dragged; the next question is asked as they are let go. */
function Ends({ interval, frames, rateHz }: { interval: Interval; frames: number; rateHz: number }) {
  const set = useParameters();
  const [origin] = useParameter("of");
  const { take, start, stop, mirrored } = interval;
  const [ends, setEnds] = useState<[number, number]>([start, stop]);
  const [range, setRange] = useState(() => rangeAround(start, stop, frames));
  useEffect(() => {
    setEnds([start, stop]);
    // the range stays while somebody drags, until an end has come to its edge
    setRange((before) => (start > before[0] && stop < before[1] ? before : rangeAround(start, stop, frames)));
  }, [start, stop, frames]);
  const shown = (frame: number) => `${shownSeconds(frame, rateHz)} s`;
  return (
    <div className="ends">
      <RangeSlider
        size="sm"
        min={range[0]}
        max={range[1]}
        step={1}
        minRange={1}
        value={ends}
        label={shown}
        thumbFromLabel="The example begins"
        thumbToLabel="The example ends"
        onChange={setEnds}
        onChangeEnd={([from, to]) =>
          set({
            ...(mirrored
              ? { more: JSON.stringify([packed({ take, start: from, stop: to, mirrored })]) }
              : { take, from: String(from), to: String(to), more: null }),
            of: origin ?? [take, start, stop].join(" "), // verdicts stay
          })
        }
      />
    </div>
  );
}

/** Return the frames that can be reached from an interval: twice its length on both sides, within the take. */
function rangeAround(start: number, stop: number, frames: number): [number, number] {
  const length = stop - start;
  return [Math.max(0, start - 2 * length), Math.min(frames, stop + 2 * length)];
}

function Remarks({ found }: { found: ExamplesAnswer }) {
  const weights = Object.entries(found.template.weights).sort((one, other) => other[1] - one[1]);
  return (
    <>
      <Text size="xs" className="muted" mt="xs">
        {counted(found.template.columns, "column")}{found.template.clips.length > 1 && ` of ${found.template.clips.length} examples`}
      </Text>
      {weights.length > 0 && (
        <details>
          <summary>{weights.length} features count more, by what was rejected</summary>
          <ul className="contradicted">
            {weights.map(([name, weight]) => (
              <li key={name}>
                {name} <span className="muted">× {weight.toFixed(2)}</span>
              </li>
            ))}
          </ul>
        </details>
      )}
      {found.remarks.map((remark) => (
        <Text key={remark} size="xs" mt={4}>
          {remark}
        </Text>
      ))}
    </>
  );
}

/** Return the seconds of a frame of the address; null where it names none. */
function secondsOf(frame: string | null, rateHz: number): number | null {
  const value = Number(frame ?? "x");
  return Number.isFinite(value) && value >= 0 ? Math.round((100 * value) / rateHz) / 100 : null;
}

/** Choose an example where the address has none. */
function Chooser({ store }: { store: StoreFacts }) {
  const [wanted] = useParameter("take");
  const [fromFrame] = useParameter("from");
  const [toFrame] = useParameter("to");
  const [name, setName] = useState(wanted ?? "");
  const [from, setFrom] = useState<number | string>(secondsOf(fromFrame, store.rate_hz) ?? 0);
  const [to, setTo] = useState<number | string>(secondsOf(toFrame, store.rate_hz) ?? 2);
  const set = useParameters();
  const found = useNamedTakes(name === "" ? [] : [name]);
  const known = found?.get(name);
  const frames = (seconds: number | string) => Math.round(Number(seconds) * store.rate_hz);
  const beyond = known !== undefined && frames(to) > known.frames;
  const swapped = from !== "" && to !== "" && frames(to) <= frames(from);
  return (
    <form
      className="chooser"
      onSubmit={(event) => {
        event.preventDefault();
        if (known !== undefined) set({ take: name, from: String(frames(from)), to: String(frames(to)) }, true);
      }}
    >
      <Text size="sm">
        Select an interval on the page of a <Link href="/take">take</Link> and choose “Search by this”, or name it here.
      </Text>
      <Group align="end" gap={8} mt="sm">
        <TakeName width={280} value={name} onChange={setName} />
        <NumberInput size="xs" w={96} label="From (s)" value={from} onChange={setFrom} min={0} step={0.1} decimalScale={2} />
        <NumberInput size="xs" w={96} label="To (s)" value={to} onChange={setTo} min={0} step={0.1} decimalScale={2} />
        <Button size="compact-sm" type="submit" disabled={known === undefined || frames(to) <= frames(from) || beyond}>
          Search
        </Button>
      </Group>
      {swapped && (
        <Text size="xs" className="remark" role="alert" mt={6}>
          The interval has to end after it begins.
        </Text>
      )}
      {name !== "" && found?.size === 0 && (
        <Text size="xs" className="muted" mt={6}>
          No take has this name.
        </Text>
      )}
      {known !== undefined && (
        <Text size="xs" className="muted" mt={6}>
          {name} lasts {known.seconds.toFixed(2)} s{beyond ? ": the interval ends behind it" : ""}.
        </Text>
      )}
    </form>
  );
}
