// Search by keyframes: poses by features that are on, off or either, the time between them, and the same as YAML. The
// count and the hits follow while somebody edits; an answer to an earlier state is dropped.

import { Button, Group, Text, TextInput } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useRef, useState } from "react";

import { get, post } from "../api/client";
import { shownSeconds } from "../api/seconds";
import type { StoreFacts } from "../api/types";
import { useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useSelection } from "../archive/selection";
import { counted } from "../archive/text";
import { PoseCard, type Seen, TimeBetween } from "./PoseCard";
import { addPose, MAX_POSES, withGap, withoutPose, withPose } from "./poses";
import { Results } from "./Results";
import { useRefine } from "./refine";
import { SaveBar } from "./SaveBar";
import { TakeName, useNamedTakes } from "./TakeName";
import type { KeyframesAnswer, Query } from "./types";

type Draft = { text: string } | { query: Query };

const EMPTY: Query = { name: "query", poses: [], gaps: [] };
const WAIT_MS = 90;
const SHOWN = 60;

export function ByKeyframes({ store }: { store: StoreFacts }) {
  const [yaml] = useParameter("yaml");
  const { filters, where } = useSelection();
  const refine = useRefine("keyframes");
  const set = useParameters();
  const [draft, setDraft] = useState<Draft>(() => (yaml === null ? { query: EMPTY } : { text: yaml }));
  const [seen, setSeen] = useState<Record<number, Seen>>({});
  const [count, setCount] = useState(SHOWN);
  const written = useRef(yaml);
  // a link or the button Back has brought another query
  useEffect(() => {
    if (yaml !== written.current) {
      written.current = yaml;
      setDraft(yaml === null ? { query: EMPTY } : { text: yaml });
    }
  }, [yaml]);
  const body = useMemo(() => {
    const empty = "query" in draft ? draft.query.poses.length === 0 : draft.text.trim() === "";
    return empty ? null : JSON.stringify({ ...draft, limit: count, filters, ...(where === null ? {} : { where }) });
  }, [draft, filters, where, count]);
  const [settled] = useDebouncedValue(body, WAIT_MS);
  const answer = useQuery({
    queryKey: ["version", "ask-keyframes", settled],
    queryFn: ({ signal }) => post<KeyframesAnswer>("/api/ask/keyframes", JSON.parse(settled as string), signal),
    enabled: settled !== null,
    placeholderData: keepPreviousData,
  });
  const found = settled === null || body === null ? undefined : answer.data;
  const current = settled === body && !answer.isPlaceholderData && !answer.isFetching;
  useSame(found);
  useEffect(() => {
    if (found === undefined || !current || found.fault !== null || found.text === written.current) return;
    written.current = found.text;
    set({ yaml: found.text });
  }, [found, current, set]);

  const query = "query" in draft ? draft.query : (found?.query ?? null);
  const edit = (next: Query) => setDraft({ query: next });
  const add = (text: Query | null, from: Seen | null) => {
    if (text === null) return;
    const base = query ?? EMPTY;
    const [pose] = text.poses;
    if (pose === undefined || base.poses.length >= MAX_POSES) return;
    if (from !== null) setSeen({ ...seen, [base.poses.length]: from });
    edit(addPose(base, pose));
  };
  const fault = found?.fault ?? null;
  const text = "text" in draft ? draft.text : (found?.text ?? "");
  return (
    <div className="ask-body keyframes">
      <section className="question" aria-label="The query">
        <FromTake store={store} onPose={add} onQuery={(next) => (setSeen({}), edit(next))} />
        {query === null && <Text size="sm">This text holds more than a sequence of poses: edit it below.</Text>}
        {query?.poses.map((pose, i) => (
          <div key={i}>
            {i > 0 && (
              <TimeBetween
                gap={query.gaps[i - 1] ?? { low: 0, high: 1 }}
                rateHz={store.rate_hz}
                label={`Time from pose ${i} to pose ${i + 1}`}
                onChange={(gap) => edit(withGap(query, i - 1, gap))}
              />
            )}
            <PoseCard
              place={i}
              pose={pose}
              seen={seen[i]}
              features={store.features}
              onChange={(next) => edit(withPose(query, i, next))}
              onRemove={() => {
                setSeen({});
                edit(withoutPose(query, i));
              }}
            />
          </div>
        ))}
        {query !== null && query.poses.length < MAX_POSES && (
          <Button size="compact-sm" variant="default" mt="xs" onClick={() => edit(addPose(query, { on: [], off: [] }))}>
            Add a pose
          </Button>
        )}
        <label className="yaml">
          <span>The same as YAML</span>
          <textarea
            className="code"
            spellCheck={false}
            rows={Math.min(16, Math.max(6, text.split("\n").length))}
            value={text}
            aria-invalid={fault !== null}
            aria-describedby="yaml-fault"
            onChange={(event) => setDraft({ text: event.currentTarget.value })}
          />
        </label>
        <Text id="yaml-fault" size="sm" c="red" role="alert">
          {fault !== null && `${fault.line === null ? "" : `Line ${fault.line}: `}${fault.message}`}
        </Text>
      </section>
      <section className="answer" aria-label="Hits">
        {answer.isError && <Fault fault={answer.error} retry={() => void answer.refetch()} />}
        {found !== undefined && fault === null && (
          <>
            <Text size="sm" role="status" aria-live="polite">
              {counted(found.total, "interval")} in {counted(found.takes, "take")},{" "}
              {(100 * found.share).toPrecision(2)} % of all frames{" "}
              <span className="muted">
                · {(1000 * found.seconds).toFixed(0)} ms{current ? "" : " · searching…"}
              </span>
            </Text>
            {found.remarks.map((remark) => (
              <Text key={remark} size="xs">
                {remark}
              </Text>
            ))}
            <SaveBar
              hits={found.hits}
              query={{ name: found.query?.name ?? "queries", text: found.text }}
              onRefine={refine}
            />
            <Results hits={found.hits} rateHz={store.rate_hz} old={!current} />
            {found.total > found.hits.length && count < 500 && (
              <Button size="compact-sm" variant="default" onClick={() => setCount(Math.min(500, count + SHOWN))}>
                Show more hits
              </Button>
            )}
          </>
        )}
        {found === undefined && !answer.isError && (
          <Text size="sm">
            Add a pose, and name features that are on or off in it; or take poses from a take. Hits appear as you edit.
          </Text>
        )}
      </section>
    </div>
  );
}

interface Reading {
  on: string[];
  off: string[];
}

/** Poses from the take that the address names: at a frame, or those of an interval that stand out. */
function FromTake({
  store,
  onPose,
  onQuery,
}: {
  store: StoreFacts;
  onPose: (query: Query | null, seen: Seen | null) => void;
  onQuery: (query: Query) => void;
}) {
  const [take, setTake] = useParameter("take");
  const [frame, setFrame] = useParameter("frame");
  const [from] = useParameter("from");
  const [to] = useParameter("to");
  const [fault, setFault] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const takes = useNamedTakes(take === null || take === "" ? [] : [take]);
  const known = takes?.get(take ?? "");
  const [id, frames] = [known?.id, known?.frames];
  const propose = async (start: number, stop: number, keyframes: number) => {
    setBusy(true);
    setFault(null);
    try {
      const made = await post<{ query: Query | null }>("/api/ask/propose", { take_id: id, start, stop, keyframes });
      return made.query;
    } catch (reason) {
      setFault(reason);
      return null;
    } finally {
      setBusy(false);
    }
  };
  const atFrame = async () => {
    const at = Math.round(Number(frame));
    if (id === undefined || frames === undefined || !(at >= 0 && at < frames)) return;
    const made = await propose(at, at + 1, 1);
    const reading = await fetchReading(id, at).catch(() => null);
    onPose(made, reading === null ? null : { take_id: id, frame: at, ...reading });
  };
  const ofInterval = async () => {
    const made = await propose(Number(from), Number(to), 3);
    if (made !== null) onQuery(made);
  };
  return (
    <form
      className="from-take"
      onSubmit={(event) => {
        event.preventDefault();
        void atFrame();
      }}
    >
      <Group gap={6} align="end">
        <TakeName width={160} value={take ?? ""} onChange={setTake} />
        <TextInput
          size="xs"
          label="Frame"
          w={58}
          inputMode="numeric"
          value={frame ?? ""}
          onChange={(event) => setFrame(event.currentTarget.value.replace(/\D/g, ""))}
        />
        <Button size="compact-sm" variant="default" type="submit" loading={busy} disabled={id === undefined || !frame}>
          Add this pose
        </Button>
        {id !== undefined && from !== null && to !== null && (
          <Button size="compact-sm" variant="default" loading={busy} onClick={() => void ofInterval()}>
            Propose from {shownSeconds(Number(from), store.rate_hz, 1)} to {shownSeconds(Number(to), store.rate_hz, 1)} s
          </Button>
        )}
      </Group>
      {take !== null && take !== "" && takes !== undefined && id === undefined && (
        <Text size="xs" c="red">
          No take has this name.
        </Text>
      )}
      {frames !== undefined && frame !== null && Number(frame) >= frames && (
        <Text size="xs" c="red">
          The take has frames 0 to {frames - 1}.
        </Text>
      )}
      {fault !== null && <Fault fault={fault} />}
    </form>
  );
}

async function fetchReading(id: number, frame: number): Promise<Reading> {
  return get<Reading>(`/api/takes/${id}/pose?frame=${frame}`);
}
