// The queue of doubtful annotations: one at a time, in a loop beside its nearest example, answered by a key.

import { Alert, Anchor, Button, Group, Loader, MultiSelect, NativeSelect, Text, TextInput, Title } from "@mantine/core";
import { useEffect, useMemo, useRef, useState } from "react";
import { Link } from "wouter";

import { useStore } from "../api/queries";
import { useJsonParameter, useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useShortcuts } from "../app/shortcuts";
import { SmallFigure } from "../motion/SmallFigure";
import { decide, step, useDecisions } from "./decisions";
import { type Change, newId } from "./edits";
import { askQueue, type QueueBlock, type QueueFilter, type QueueRow, useClassNames, useLabelFacts } from "./load";

const NO_NAMES: string[] = [];

const keyOf = (row: QueueRow) => `${row.take}/${row.class}/${row.subclass ?? ""}/${row.start}/${row.stop}`;

type Answer = { accept: boolean; id: string };

export function Queue({ annotator }: { annotator: string }) {
  const store = useStore().data;
  const labels = useLabelFacts().data?.labels ?? 0;
  const [classes, setClasses] = useJsonParameter<string[]>("classes", NO_NAMES);
  const [take, setTake] = useParameter("takes");
  const [where, setWhere] = useParameter("where");
  const [stage, setStage] = useParameter("stage");
  const text = JSON.stringify([classes, take, where, stage]);
  const filter = useMemo<QueueFilter>(
    () => ({ classes, takes: take === null ? [] : [take], where, stage }),
    // eslint-disable-next-line react-hooks/exhaustive-deps
    [text],
  );
  const queue = useQueue(filter, store?.version, annotator);
  const { row, rows, at, answers, block } = queue;
  useSame(block);
  const editable = store?.read_only === false;
  const answer = (accept: boolean) => editable && queue.answer(accept);
  useShortcuts("Doubtful", [
    { keys: "y", what: "Yes: accept", run: () => answer(true) },
    { keys: "n", what: "No: reject", run: () => answer(false) },
    { keys: " ", what: "Leave it undecided", run: () => queue.go(at + 1) },
    { keys: "ArrowRight", what: "The next one", run: () => queue.go(at + 1) },
    { keys: "ArrowLeft", what: "The one before", run: () => queue.go(at - 1) },
    { keys: "mod+z", what: "Undo (with Shift: redo)", run: (event) => queue.back(event.shiftKey ? "redo" : "undo") },
    { keys: "mod+y", what: "Redo", run: () => queue.back("redo") },
  ]);
  return (
    <>
      <Group gap={8} align="end">
        <Filters classes={classes} setClasses={setClasses} take={take} setTake={setTake} where={where} setWhere={setWhere} />
        {store !== undefined && store.stages.annotate.length > 1 && (
          <NativeSelect
            size="xs"
            label="Annotated by"
            value={stage ?? block?.stage ?? ""}
            onChange={(event) => setStage(event.currentTarget.value)}
            data={store.stages.annotate}
          />
        )}
      </Group>
      {queue.fault !== null && <Fault fault={queue.fault} retry={queue.reload} />}
      {queue.fault === null && block === undefined && <Loader size="sm" aria-label="The queue is being read" />}
      {block?.stage === null && (
        <Alert color="blue" variant="light" title="Nothing was annotated yet">
          {labels > 0 ? (
            <>
              {labels.toLocaleString("en")} labels of people are there: go on under{" "}
              <Anchor component={Link} href="/label?view=learn" size="sm">Learn</Anchor>, and what is found with them is asked about here.
            </>
          ) : (
            <>
              Open a take under <Anchor component={Link} href="/take" size="sm">Take</Anchor>, select where it shows a class, and choose
              Label this; or search by it, and accept hits. After a few labels, go on under{" "}
              <Anchor component={Link} href="/label?view=learn" size="sm">Learn</Anchor>.
            </>
          )}
        </Alert>
      )}
      {block !== undefined && block.stage !== null && (
        <>
          <Counts block={block} answers={answers} />
          <div className="queue">
            {row === undefined ? (
              <Text>All of these are decided.</Text>
            ) : (
              <Card row={row} answer={answers.get(keyOf(row))} onAnswer={answer} onSkip={() => queue.go(at + 1)} editable={editable} />
            )}
            <ol className="queue-list" aria-label="Annotations, the least confident first">
              {rows.slice(Math.max(0, at - 5), at + 30).map((one) => (
                <li key={keyOf(one)}>
                  <button type="button" aria-current={one === row} onClick={() => queue.go(rows.indexOf(one))}>
                    <Mark answer={answers.get(keyOf(one))} /> {one.class} · {one.take} [{one.start}:{one.stop}]
                    {one.confidence !== null && ` · ${Math.round(100 * one.confidence)} %`}
                  </button>
                </li>
              ))}
            </ol>
          </div>
        </>
      )}
    </>
  );
}

function Mark({ answer }: { answer: Answer | undefined }) {
  if (answer === undefined) return null;
  return answer.accept ? <span className="queue-yes">yes</span> : <span className="queue-no">no</span>;
}

function Filters(props: {
  classes: string[];
  setClasses: (value: string[] | null) => void;
  take: string | null;
  setTake: (value: string | null) => void;
  where: string | null;
  setWhere: (value: string | null) => void;
}) {
  const names = useClassNames();
  const [text, setText] = useState({ take: props.take ?? "", where: props.where ?? "" });
  return (
    <Group gap={8} align="end">
      <MultiSelect
        size="xs"
        w={260}
        label="Classes"
        placeholder={props.classes.length === 0 ? "all" : ""}
        searchable
        clearable
        data={names}
        value={props.classes}
        onChange={(value) => props.setClasses(value.length === 0 ? null : value)}
      />
      <TextInput
        size="xs"
        w={180}
        label="Take"
        placeholder="all"
        value={text.take}
        onChange={(event) => setText({ ...text, take: event.currentTarget.value })}
        onBlur={() => props.setTake(text.take.trim() || null)}
        onKeyDown={(event) => event.key === "Enter" && props.setTake(text.take.trim() || null)}
      />
      <TextInput
        size="xs"
        w={260}
        label="SQL over annotations"
        placeholder="confidence < 0.9"
        value={text.where}
        onChange={(event) => setText({ ...text, where: event.currentTarget.value })}
        onBlur={() => props.setWhere(text.where.trim() || null)}
        onKeyDown={(event) => event.key === "Enter" && props.setWhere(text.where.trim() || null)}
      />
    </Group>
  );
}

function Counts({ block, answers }: { block: QueueBlock; answers: ReadonlyMap<string, Answer> }) {
  const yes = [...answers.values()].filter((one) => one.accept).length;
  const no = answers.size - yes;
  const left = Math.max(0, block.open - answers.size);
  return (
    <Text size="sm" aria-live="polite" data-testid="queue-counts">
      {left.toLocaleString("en")} undecided of {block.total.toLocaleString("en")} annotations of {block.stage} ·{" "}
      {block.accepted + yes} accepted · {block.rejected + no} rejected
    </Text>
  );
}

function Card(props: { row: QueueRow; answer: Answer | undefined; onAnswer: (accept: boolean) => void; onSkip: () => void; editable: boolean }) {
  const { row, answer, onAnswer, onSkip, editable } = props;
  const { nearest } = row;
  const address = `/label?take=${encodeURIComponent(row.take)}&from=${row.start}&to=${row.stop}`;
  return (
    <section className="queue-card" aria-label="The annotation to decide on">
      <Title order={2}>
        Is this {row.subclass ?? row.class}? <Mark answer={answer} />
      </Title>
      <div className="queue-pair">
        <figure>
          {row.take_id !== null && (
            <SmallFigure item={{ take_id: row.take_id, start: row.start, stop: row.stop }} width={300} height={300} label={`${row.take}, frames ${row.start} to ${row.stop}`} />
          )}
          <figcaption>
            {row.take} [{row.start}:{row.stop}]{row.confidence !== null && `, confidence ${Math.round(100 * row.confidence)} %`}
          </figcaption>
        </figure>
        {nearest !== null && (
          <figure>
            <SmallFigure item={nearest} width={300} height={300} label={`The nearest example: ${nearest.take}, frames ${nearest.start} to ${nearest.stop}`} />
            <figcaption>
              nearest example: {nearest.take} [{nearest.start}:{nearest.stop}]
            </figcaption>
          </figure>
        )}
      </div>
      <Group gap={8}>
        <Button onClick={() => onAnswer(true)} disabled={!editable}>
          Yes (y)
        </Button>
        <Button variant="default" onClick={() => onAnswer(false)} disabled={!editable}>
          No (n)
        </Button>
        <Button variant="default" onClick={onSkip}>
          Skip (space)
        </Button>
        <Button variant="subtle" component={Link} href={address}>
          Correct it in lanes
        </Button>
      </Group>
    </section>
  );
}

/** Return the queue as it was read, the place in it, and what was answered since. */
function useQueue(filter: QueueFilter, version: number | undefined, annotator: string) {
  const [rows, setRows] = useState<QueueRow[]>([]);
  const [block, setBlock] = useState<QueueBlock>();
  const [at, setAt] = useState(0);
  const [given, setAnswers] = useState<ReadonlyMap<string, Answer>>(new Map());
  const [fault, setFault] = useState<unknown>(null);
  const [round, setRound] = useState(0);
  const { pending, undo, refused } = useDecisions();
  const refusals = useRef(refused.length);
  useEffect(() => {
    if (pending.length > 0) return;
    if (refused.length > refusals.current) setRound((one) => one + 1); // others have decided what this list shows as undecided
    refusals.current = refused.length;
  }, [pending.length, refused.length]);
  const answers = useMemo(() => {
    const standing = new Set(undo.flatMap((one) => one.made)); // without those that were undone or refused
    return new Map([...given].filter(([, one]) => standing.has(one.id)));
  }, [given, undo]);
  useEffect(() => {
    const stop = new AbortController();
    setFault(null);
    askQueue(filter, 0, stop.signal).then(
      (found) => {
        setBlock(found);
        setRows(found.rows);
        setAnswers(new Map());
        setAt(0);
      },
      (reason: unknown) => !stop.signal.aborted && setFault(reason),
    );
    return () => stop.abort();
  }, [filter, version, round]);
  const more = async () => {
    if (block === undefined || pending.length > 0) return;
    // those that were left undecided are the first of the queue still
    const open = rows.filter((one) => !answers.has(keyOf(one))).length;
    const found = await askQueue(filter, open);
    const known = new Set(rows.map(keyOf));
    setRows([...rows, ...found.rows.filter((one) => !known.has(keyOf(one)))]);
  };
  const go = (to: number) => {
    if (to < 0 || to > rows.length) return;
    setAt(to);
    if (to >= rows.length - 5) more().catch(setFault);
  };
  const answer = (accept: boolean) => {
    const row = rows[at];
    if (row === undefined || block === undefined || block.stage === null) return;
    const before = answers.get(keyOf(row));
    if (before?.accept === accept) return go(at + 1);
    const { class: label, subclass, start, stop } = row;
    const change: Change = { do: accept ? "accept" : "reject", id: newId(), stage: block.stage, class: label, subclass, start, stop, seen: before?.id ?? row.label };
    decide(row.take, [change], annotator);
    setAnswers(new Map(given).set(keyOf(row), { accept, id: change.id }));
    go(at + 1);
  };
  const back = (way: "undo" | "redo") => {
    const made = new Set(undo.at(-1)?.made);
    step(way, annotator);
    const place = rows.findIndex((one) => made.has(answers.get(keyOf(one))?.id ?? ""));
    if (way === "undo" && place >= 0) setAt(place);
    else if (pending.length === 0) setTimeout(() => setRound(round + 1), 300); // what it was about is not in this list
  };
  return { rows, row: rows[at], at, answers, block, fault, go, answer, back, reload: () => setRound(round + 1) };
}
