// The labels of one take: the player, lanes in which labels are made, and what is known of the one that is chosen.

import "../take/take.css";

import { Badge, Button, Group, Loader, Text, Title } from "@mantine/core";
import { useCallback, useEffect, useMemo, useRef, useState, useSyncExternalStore } from "react";
import { Link } from "wouter";

import { useStore } from "../api/queries";
import type { StoreFacts } from "../api/types";
import { useParameter } from "../app/address";
import { takeAddress } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useShortcuts } from "../app/shortcuts";
import { classColour } from "../app/theme";
import { makeBody } from "../motion/body";
import type { Actor } from "../motion/actors";
import { clock } from "../take/axis";
import { useKeys } from "../take/keys";
import { useDocument, useMotion } from "../take/load";
import { Player } from "../take/Player";
import { Session } from "../take/session";
import type { TakeDocument } from "../take/types";
import { ClassInput } from "./ClassInput";
import { decide, step, useDecisions } from "./decisions";
import { type Annotation, type Change, currentLabels, decisionOn, type Edits, type LabelRow, newId, verdictOn, withChanges } from "./edits";
import { type Chosen, type Item, isChosen, LabelLanes, type Lane, makeLanes } from "./LabelLanes";
import { useClassNames, useTakeLabels } from "./load";
import { SegmentPanel } from "./SegmentPanel";

export function TakeLabels({ name, annotator }: { name: string; annotator: string }) {
  const store = useStore();
  const document = useDocument(name);
  const fault = document.error ?? store.error;
  if (fault !== null) return <Fault fault={fault} retry={() => void document.refetch()} />;
  if (document.data === undefined || store.data === undefined)
    return <Loader m="md" size="sm" aria-label="The take is being opened" />;
  return <OpenLabels key={document.data.take_id} document={document.data} store={store.data} annotator={annotator} />;
}

const NOTHING: readonly never[] = [];
const sameFrame = (_actor: number, frame: number) => frame;

/** Return the rows of labels of a take as they are once everything that is on its way is saved. */
function useRows(document: TakeDocument, annotator: string) {
  const { take_id: id, name, version } = document;
  const labels = useTakeLabels(id, name, version);
  const { pending } = useDecisions();
  const saved = labels.data?.rows ?? NOTHING;
  const rows = useMemo(
    () => withChanges(saved, pending.filter((one) => one.take === name).flatMap((one) => one.changes), annotator),
    [saved, pending, name, annotator],
  );
  return { labels, rows };
}

interface OpenProps {
  document: TakeDocument;
  store: StoreFacts;
  annotator: string;
}

function OpenLabels({ document, store, annotator }: OpenProps) {
  const { take_id: id, name, version } = document;
  const session = useSession(document);
  const body = useMemo(() => makeBody(store.joints, store.parents), [store]);
  const { motion, fault: motionFault } = useMotion(id, version, session);
  const actors = useMemo<Actor[]>(() => [{ motion }], [motion]);
  const { labels, rows } = useRows(document, annotator);
  const current = useMemo(() => currentLabels(rows), [rows]);
  const annotations: readonly Annotation[] = labels.data?.annotations ?? NOTHING;
  const lanes = useMemo(() => makeLanes(current, annotations, !store.read_only), [current, annotations, store.read_only]);
  const [label, setLabel] = useParameter("class");
  const [chosen, choose] = useState<Chosen>(null);
  const item = useMemo(
    () => lanes.flatMap((lane) => lane.items).find((one) => isChosen(one, chosen)) ?? null,
    [lanes, chosen],
  );
  useFirstChoice(lanes, chosen, choose);
  const input = useRef<HTMLInputElement>(null);
  const edits = useEdits({ name, annotator, session, current, stage: labels.data?.stage ?? null, choose, store });
  const colourOf = useColours(lanes);
  const onChoose = useCallback((one: Item | null) => choose(toChosen(one)), []);
  const draw = useCallback(
    (as: string, start: number, stop: number) => {
      const wanted = as.trim();
      if (wanted === "") input.current?.focus();
      else edits.draw(wanted, start, stop);
    },
    [edits],
  );
  const onDraw = (lane: Lane, start: number, stop: number) => draw(lane.class ?? label ?? "", start, stop);
  const onLabel = (as: string) => {
    const { selection } = session.shown;
    setLabel(as);
    if (selection !== null) draw(as, ...selection);
  };
  useSame(labels.data);
  useLabelKeys({ session, item, lanes, edits, choose: onChoose, input, onLabel: () => onLabel(label ?? ""), readOnly: store.read_only });
  const fault = motionFault ?? labels.error;
  return (
    <>
      <Header document={document} annotations={annotations} labels={current} stage={labels.data?.stage ?? null} />
      {fault !== null && fault !== undefined && <Fault fault={fault} />}
      <div className="label-upper">
        <Player session={session} body={body} actors={actors} frameOf={sameFrame} label={`The motion of ${name} as a figure`} />
        <aside className="label-side" aria-label="The segment that is chosen">
          {!store.read_only && (
            <NewLabel session={session} value={label ?? ""} onChange={(value) => setLabel(value)} onLabel={onLabel} input={input} />
          )}
          <SegmentPanel
            key={item?.key}
            item={item}
            rows={rows}
            takeId={id}
            frames={document.frames}
            rateHz={document.rate_hz}
            edits={edits}
            readOnly={store.read_only}
          />
        </aside>
      </div>
      <section aria-label="Lanes">
        <Group gap={10} mb={4}>
          <Title order={2}>Lanes</Title>
          <Text size="xs" className="muted">
            {store.read_only ? "drag in a lane: select" : "drag in a lane: draw · drag a label: move, its ends: correct"} · click: choose · wheel: zoom ·
            Shift and wheel: pan
          </Text>
        </Group>
        <LabelLanes
          session={session}
          lanes={lanes}
          chosen={chosen}
          colourOf={colourOf}
          editable={!store.read_only}
          onChoose={onChoose}
          onDraw={onDraw}
          onMove={(one, start, stop) => one.label !== undefined && edits.change(one.label, { start, stop })}
        />
      </section>
    </>
  );
}

/** Choose the label or annotation with the interval of the address, which may come with a later version of the store.
 *
 * It is chosen once, and not at all after the person has chosen another. */
function useFirstChoice(lanes: readonly Lane[], chosen: Chosen, choose: (chosen: Chosen) => void): void {
  const done = useRef(false);
  useEffect(() => {
    if (chosen !== null) done.current = true;
    if (done.current) return;
    const parameters = new URLSearchParams(window.location.search);
    const [from, to] = [Number(parameters.get("from") ?? "x"), Number(parameters.get("to") ?? "x")];
    const found = lanes.flatMap((lane) => lane.items).find((one) => one.start === from && one.stop === to);
    if (found !== undefined) choose(toChosen(found));
  }, [lanes, chosen, choose]);
}

const toChosen = (item: Item | null): Chosen =>
  item === null ? null : item.kind === "label" ? { kind: "label", id: item.key } : { kind: "annotation", key: item.key };

function Header(props: { document: TakeDocument; annotations: readonly Annotation[]; labels: readonly LabelRow[]; stage: string | null }) {
  const { document, annotations, labels, stage } = props;
  const open = annotations.filter((one) => verdictOn(one, labels) === undefined).length;
  return (
    <Group gap={8}>
      <Title order={1}>{document.name}</Title>
      {typeof document.columns.class === "string" && <Badge variant="light" tt="none">{document.columns.class}</Badge>}
      <Text size="sm" className="muted" aria-live="polite">
        {clock(document.seconds)} · {labels.length} {labels.length === 1 ? "label" : "labels"}
        {stage === null ? "" : ` · ${open} of ${annotations.length} annotations of ${stage} undecided`}
      </Text>
      <Button size="compact-xs" variant="default" component={Link} href={takeAddress(document.name)}>
        Open the take
      </Button>
    </Group>
  );
}

function NewLabel(props: {
  session: Session;
  value: string;
  onChange: (value: string) => void;
  onLabel: (value: string) => void;
  input: React.RefObject<HTMLInputElement | null>;
}) {
  const { session, value, onChange, onLabel, input } = props;
  const { selection } = useSyncExternalStore(session.subscribe, () => session.shown);
  return (
    <div>
      <ClassInput ref={input} label="Class of new labels" value={value} onChange={onChange} onDone={onLabel} />
      <Group gap={6} my={6}>
        <Button size="compact-sm" disabled={selection === null || value.trim() === ""} onClick={() => onLabel(value)}>
          Label the selection
        </Button>
        <Text size="xs" className="muted">
          {selection === null ? "drag in a lane, or press [ and ]" : `frames ${selection[0]} to ${selection[1]}`}
        </Text>
      </Group>
    </div>
  );
}

interface EditContext {
  name: string;
  annotator: string;
  session: Session;
  current: readonly LabelRow[];
  stage: string | null;
  choose: (chosen: Chosen) => void;
  store: StoreFacts;
}

function useEdits(context: EditContext): Edits {
  const now = useRef(context);
  now.current = context;
  return useMemo(() => {
    const make = (changes: Change[], chosen?: string) => {
      const { name, annotator, choose, store } = now.current;
      if (store.read_only) return;
      decide(name, changes, annotator);
      if (chosen !== undefined) choose({ kind: "label", id: chosen });
    };
    const change: Edits["change"] = (label, values) => {
      const given = Object.entries(values).filter(([key, value]) => value !== undefined && value !== label[key as keyof LabelRow]);
      if (given.length === 0) return;
      const id = newId();
      make([{ do: "change", id, label: label.id, ...Object.fromEntries(given) }], id);
    };
    const back = (way: "undo" | "redo") => {
      step(way, now.current.annotator);
      now.current.choose(null);
    };
    return {
      draw: (label, start, stop) => {
        const id = newId();
        make([{ do: "draw", id, class: label, start, stop }], id);
        now.current.session.select(null);
      },
      change,
      split: (label) => {
        const at = Math.floor(now.current.session.frame);
        if (at <= label.start || at >= label.stop) return;
        const ids: [string, string] = [newId(), newId()];
        make([{ do: "split", ids, label: label.id, at }], ids[1]);
      },
      join: (label) => {
        const next = nextOf(label, now.current.current);
        if (next === undefined) return;
        const ids = [newId(), newId()];
        make([{ do: "join", ids, labels: [label.id, next.id] }], ids[0]);
      },
      withdraw: (label) => make([{ do: "withdraw", id: newId(), label: label.id }]),
      decide: (annotation, accept) => {
        const { stage, current } = now.current;
        if (stage === null) return;
        const { class: label, subclass, start, stop } = annotation;
        const seen = decisionOn(annotation, current)?.id ?? null;
        make([{ do: accept ? "accept" : "reject", id: newId(), stage, class: label, subclass, start, stop, seen }]);
      },
      correct: (annotation) => {
        const { stage } = now.current;
        const { class: label, subclass, start, stop } = annotation;
        const [id, seen] = [newId(), decisionOn(annotation, now.current.current)];
        if (seen?.verdict === "positive") now.current.choose({ kind: "label", id: seen.id });
        else if (stage !== null) make([{ do: "accept", id, stage, class: label, subclass, start, stop, seen: seen?.id ?? null }], id);
      },
      undo: () => back("undo"),
      redo: () => back("redo"),
    };
  }, []);
}

/** Return the label that `join` adds: the next one of the same class, limb and verdict. */
export function nextOf(label: LabelRow, current: readonly LabelRow[]): LabelRow | undefined {
  return current
    .filter((one) => one.id !== label.id && one.class === label.class && one.limb === label.limb && one.verdict === label.verdict)
    .filter((one) => one.start >= label.start)
    .sort((a, b) => a.start - b.start)[0];
}

function useColours(lanes: readonly Lane[]): (name: string) => string {
  const names = useClassNames();
  return useMemo(() => {
    const every = [...new Set([...names, ...lanes.map((lane) => lane.class ?? "")])].sort();
    const place = new Map(every.map((name, i) => [name, i]));
    return (name) => classColour(place.get(name) ?? 0);
  }, [names, lanes]);
}

interface KeysProps {
  session: Session;
  item: Item | null;
  lanes: readonly Lane[];
  edits: Edits;
  choose: (item: Item | null) => void;
  input: React.RefObject<HTMLInputElement | null>;
  onLabel: () => void;
  readOnly: boolean;
}

/** Keys that change nothing. */
const LOOKING = new Set(["j", "k", "w"]);

function useLabelKeys({ session, item, lanes, edits, choose, input, onLabel, readOnly }: KeysProps): void {
  const items = useMemo(() => lanes.flatMap((lane) => lane.items).sort((a, b) => a.start - b.start || a.stop - b.stop), [lanes]);
  const starts = useMemo(() => [...new Set(items.map((one) => one.start))], [items]);
  useKeys(session, starts);
  const label = item?.label;
  const annotation = item?.annotation;
  const go = (by: 1 | -1) => {
    const at = item === null ? -1 : items.indexOf(item);
    const beyond = by > 0 ? items.find((one) => one.start >= session.frame) : items.findLast((one) => one.start < session.frame);
    const next = at < 0 ? beyond : items[at + by];
    if (next === undefined) return;
    choose(next);
    session.seek(next.start);
  };
  const verdict = (accept: boolean) => {
    if (annotation !== undefined) edits.decide(annotation, accept);
    else if (label !== undefined) edits.change(label, { verdict: accept ? "positive" : "negative" });
  };
  const edge = (which: "start" | "stop", frame: number) => label !== undefined && edits.change(label, { [which]: frame });
  const at = () => Math.floor(session.frame);
  const toInput = () => {
    input.current?.focus();
    input.current?.select();
  };
  const chosenInput = () => (document.querySelector<HTMLInputElement>(".label-side [data-chosen-class] input") ?? input.current)?.select();
  const shortcuts = [
    { keys: "l", what: "Label the selection with the class of new labels", run: onLabel },
    { keys: "x", what: "Write the class of new labels", run: toInput },
    { keys: "k", what: "Choose the next label or annotation", run: () => go(1) },
    { keys: "j", what: "Choose the previous label or annotation", run: () => go(-1) },
    { keys: "y", what: "Accept what is chosen", run: () => verdict(true) },
    { keys: "n", what: "Reject what is chosen", run: () => verdict(false) },
    { keys: "e", what: "Accept the chosen annotation as a label whose edges can be corrected", run: () => annotation !== undefined && edits.correct(annotation) },
    { keys: "{", what: "The chosen label begins here", run: () => label !== undefined && at() < label.stop && edge("start", at()) },
    { keys: "}", what: "The chosen label ends here", run: () => label !== undefined && at() + 1 > label.start && edge("stop", at() + 1) },
    { keys: "s", what: "Split the chosen label here", run: () => label !== undefined && edits.split(label) },
    { keys: "m", what: "Join the chosen label with the next of its class", run: () => label !== undefined && edits.join(label) },
    { keys: "Enter", what: "Write another class for the chosen label", run: chosenInput },
    { keys: "Delete", what: "Take the chosen label back", run: () => label !== undefined && edits.withdraw(label) },
    { keys: "Backspace", what: "Take the chosen label back", run: () => label !== undefined && edits.withdraw(label) },
    { keys: "w", what: "Play the chosen segment in a loop", run: () => item !== null && playItem(session, item) },
    { keys: "mod+z", what: "Undo (with Shift: redo)", run: (event: KeyboardEvent) => (event.shiftKey ? edits.redo() : edits.undo()) },
    { keys: "mod+y", what: "Redo", run: edits.redo },
  ];
  useShortcuts("Label", readOnly ? shortcuts.filter((one) => LOOKING.has(one.keys)) : shortcuts);
}

export function playItem(session: Session, item: Item): void {
  session.select([item.start, item.stop]);
  session.seek(item.start);
  session.choose({ loop: true });
  session.play(true);
}

/** Return the session of a take, begun with the interval of the address as its selection. */
function useSession(document: TakeDocument): Session {
  const session = useMemo(() => {
    const made = new Session(document.frames, document.rate_hz);
    const parameters = new URLSearchParams(window.location.search);
    const [from, to] = ["from", "to"].map((one) => Number.parseInt(parameters.get(one) ?? "", 10)) as [number, number];
    if (from >= 0 && to > from && from < made.frames) {
      made.select([from, to]);
      made.seek(from);
      const margin = Math.max(2 * (to - from), document.rate_hz);
      if (to - from < made.frames / 10) made.setView({ from: from - margin, to: to + margin });
    }
    return made;
  }, [document.frames, document.rate_hz]);
  useEffect(() => () => session.end(), [session]);
  return session;
}
