// Search by example: the interval of the address, or several accepted hits, in contrast to rejected ones.

import { Autocomplete, Button, Group, NumberInput, Switch, Text } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useMemo, useState } from "react";
import { Link } from "wouter";

import { post } from "../api/client";
import type { StoreFacts, TakesBlock } from "../api/types";
import { takeAddress, useJsonParameter, useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useSelection } from "../archive/selection";
import { SmallFigure } from "../motion/SmallFigure";
import type { Explain } from "./Details";
import { Results } from "./Results";
import { SaveBar } from "./SaveBar";
import {
  asked,
  type ExamplesAnswer,
  type ExamplesQuestion,
  type HitAnswer,
  type Interval,
  type Packed,
  packed,
  samePlace,
  unpacked,
} from "./types";

const NONE: Packed[] = [];
const TAU = 0.1;
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
              {found.more ? `the ${found.total} best hits` : `${found.total} hits`} below {found.tau} in{" "}
              {found.hours.toFixed(1)} h <span className="muted">· {(1000 * found.seconds).toFixed(0)} ms</span>
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
    const start = Number(from);
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
        w={92}
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
  const ids = useTakeIds(question);
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
  const row = (one: Interval, without: () => void, key: number) => (
    <li key={key}>
      {ids.has(one.take) && (
        <SmallFigure
          item={{ take_id: ids.get(one.take) as number, start: one.start, stop: one.stop }}
          width={positives.length > 1 ? 56 : 150}
          height={positives.length > 1 ? 62 : 160}
        />
      )}
      <span>
        <Link href={takeAddress(one.take, one.start, one.stop)}>{one.take}</Link>
        <br />
        <span className="muted">
          {(one.start / store.rate_hz).toFixed(2)} to {(one.stop / store.rate_hz).toFixed(2)} s
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

/** Return the ids of the takes of a question by their names. */
function useTakeIds(question: ExamplesQuestion): Map<string, number> {
  const names = [...new Set([...question.positives, ...question.negatives].map((one) => one.take))].sort();
  const block = useQuery({
    queryKey: ["version", "take-ids", names],
    queryFn: ({ signal }) =>
      post<TakesBlock>(
        "/api/takes",
        { columns: ["name", "take_id"], filters: [{ column: "name", values: names }], limit: 500 },
        signal,
      ),
  });
  return useMemo(() => new Map((block.data?.rows ?? []).map(([name, id]) => [String(name), Number(id)])), [block.data]);
}

function Remarks({ found }: { found: ExamplesAnswer }) {
  const weights = Object.entries(found.template.weights).sort((one, other) => other[1] - one[1]);
  return (
    <>
      <Text size="xs" className="muted" mt="xs">
        {found.template.columns} columns{found.template.clips.length > 1 && ` of ${found.template.clips.length} examples`}
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

/** Choose an example where the address has none. */
function Chooser({ store }: { store: StoreFacts }) {
  const [wanted] = useParameter("take");
  const [name, setName] = useState(wanted ?? "");
  const [from, setFrom] = useState<number | string>(0);
  const [to, setTo] = useState<number | string>(2);
  const [typed] = useDebouncedValue(name, 200);
  const set = useParameters();
  const takes = useQuery({
    queryKey: ["version", "take-names", typed],
    queryFn: ({ signal }) =>
      post<TakesBlock>(
        "/api/takes",
        { columns: ["name", "seconds"], filters: typed === "" ? [] : [{ column: "name", contains: typed }], limit: 30 },
        signal,
      ),
    placeholderData: keepPreviousData,
  });
  const rows = takes.data?.rows ?? [];
  const known = rows.find(([one]) => one === name);
  const frames = (seconds: number | string) => Math.round(Number(seconds) * store.rate_hz);
  const beyond = known !== undefined && frames(to) > frames(Number(known[1]));
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
        <Autocomplete
          size="xs"
          label="Take"
          w={280}
          data={rows.map(([one]) => String(one))}
          filter={({ options }) => options}
          value={name}
          onChange={setName}
        />
        <NumberInput size="xs" w={96} label="From, seconds" value={from} onChange={setFrom} min={0} step={0.1} decimalScale={2} />
        <NumberInput size="xs" w={96} label="To, seconds" value={to} onChange={setTo} min={0} step={0.1} decimalScale={2} />
        <Button size="compact-sm" type="submit" disabled={known === undefined || frames(to) <= frames(from) || beyond}>
          Search
        </Button>
      </Group>
      {known !== undefined && (
        <Text size="xs" className="muted" mt={6}>
          {name} lasts {Number(known[1]).toFixed(2)} s{beyond ? ": the interval ends behind it" : ""}.
        </Text>
      )}
    </form>
  );
}
