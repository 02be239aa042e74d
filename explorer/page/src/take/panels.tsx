// The panels beside the player: selection, features of the pose, facts about the take.

import { Button, Group, Text } from "@mantine/core";
import { type MouseEvent, type ReactNode, useEffect, useRef, useSyncExternalStore } from "react";
import { Link, useLocation } from "wouter";

import type { Feature, Value } from "../api/types";
import { counted } from "../archive/text";
import { clock, frameClock } from "./axis";
import type { Session } from "./session";
import type { Suspect, TakeDocument } from "./types";
import type { Words } from "./words";

export function Panel({ title, children, open = true }: { title: string; children: ReactNode; open?: boolean }) {
  return (
    <details className="panel" open={open}>
      <summary>{title}</summary>
      {children}
    </details>
  );
}

export function SelectionPanel({ session, name }: { session: Session; name: string }) {
  const { selection } = useSyncExternalStore(session.subscribe, () => session.shown);
  if (selection === null)
    return (
      <Panel title="Selection">
        <Text size="sm" className="muted">
          Drag over the lanes, or press [ and ] where it begins and ends.
        </Text>
      </Panel>
    );
  const [from, to] = selection;
  const seconds = (frame: number) => frameClock(frame, session.rateHz);
  const question = `take=${encodeURIComponent(name)}&from=${from}&to=${to}`;
  return (
    <Panel title="Selection">
      <Text size="sm" aria-live="polite">
        {seconds(from)} to {seconds(to)}, {counted(to - from, "frame")} ({seconds(to - from)})
      </Text>
      <Group gap={6} mt={6}>
        <Button size="compact-sm" component={Link} href={`/ask?${question}`}>
          Search by this
        </Button>
        <Button size="compact-sm" variant="default" component={Link} href={`/label?${question}`}>
          Label this
        </Button>
        <Button size="compact-sm" variant="default" onClick={() => session.setView({ from: from - (to - from) * 0.1, to: to + (to - from) * 0.1 })}>
          Zoom to it
        </Button>
        <Button size="compact-sm" variant="default" onClick={() => session.select(null)}>
          Clear
        </Button>
      </Group>
    </Panel>
  );
}

/** The features that hold in the pose that is shown; the list changes without React. */
export function PosePanel({
  session,
  words,
  features,
  unknown,
  name,
}: {
  session: Session;
  words: Words | null;
  features: readonly Feature[];
  unknown: ReadonlySet<number>;
  name: string;
}) {
  const list = useRef<HTMLUListElement>(null);
  const note = useRef<HTMLParagraphElement>(null);
  useEffect(() => {
    const items = [...(list.current?.children ?? [])] as HTMLElement[];
    if (words === null) return;
    const hidden = items.map(() => true);
    let written = "?";
    return session.paint(() => {
      const frame = Math.min(words.frames - 1, Math.floor(session.seen));
      let count = 0;
      features.forEach(({ bit }, i) => {
        const on = words.on(frame, bit) && !unknown.has(bit);
        if (on) count++;
        if (hidden[i] === !on) return;
        hidden[i] = !on;
        (items[i] as HTMLElement).hidden = !on;
      });
      const text = words.valid(frame) ? (count === 0 ? "No feature holds." : "") : "The frame is invalid: nothing is known.";
      if (text !== written && note.current !== null) note.current.textContent = written = text;
    });
  }, [session, words, features, unknown]);
  return (
    <Panel title="Features of the pose">
      <ul ref={list} className="pose-features">
        {features.map((one) => (
          <li key={one.bit} hidden title={`F${one.bit + 1}: ${one.description}`}>
            {one.name}
          </li>
        ))}
      </ul>
      <p ref={note} className="muted" />
      {unknown.size > 0 && (
        <Text size="xs" className="muted">
          {unknown.size} features are unknown: the body lacks joints.
        </Text>
      )}
      <PoseLink session={session} name={name} />
    </Panel>
  );
}

function PoseLink({ session, name }: { session: Session; name: string }) {
  const { playing } = useSyncExternalStore(session.subscribe, () => session.shown);
  const [, navigate] = useLocation();
  const link = useRef<HTMLAnchorElement>(null);
  useEffect(
    () =>
      session.paint(() => {
        if (!playing && link.current !== null)
          link.current.setAttribute("href", `/ask?way=keyframes&take=${encodeURIComponent(name)}&frame=${Math.floor(session.frame)}`);
      }),
    [session, name, playing],
  );
  const follow = (event: MouseEvent<HTMLAnchorElement>) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    navigate(event.currentTarget.getAttribute("href") ?? "/ask");
  };
  return (
    <Button ref={link} component="a" size="compact-sm" variant="default" mt={6} href="/ask" onClick={follow}>
      Ask for this pose
    </Button>
  );
}

const FACTS = ["class", "actor", "clip", "source", "source_root", "format", "skeleton", "source_rate_hz", "source_frames", "unit", "invalid_frames"];

export function FactsPanel({ document, suspect }: { document: TakeDocument; suspect: readonly Suspect[] }) {
  const rows = FACTS.filter((name) => document.columns[name] !== undefined).map(
    (name) => [name, document.columns[name] as Value] as const,
  );
  return (
    <Panel title={suspect.length + document.warnings.length > 0 ? "About the take (with warnings)" : "About the take"}>
      {document.warnings.map((one) => (
        <p key={one} className="warning">
          ⚠ {one}
        </p>
      ))}
      {suspect.map((one) => (
        <p key={one.figure} className="warning">
          ⚠ {one.figure} is {+one.value.toPrecision(3)} {one.unit}, expected {limits(one)}: {one.meaning}
        </p>
      ))}
      <dl className="facts">
        <dt>length</dt>
        <dd>
          {clock(document.seconds, 2)}, {counted(document.frames, "frame")} at {document.rate_hz} Hz
        </dd>
        {rows.map(([name, value]) => (
          <div key={name} style={{ display: "contents" }}>
            <dt>{name.replaceAll("_", " ")}</dt>
            <dd>{String(value)}</dd>
          </div>
        ))}
      </dl>
    </Panel>
  );
}

function limits({ low, high }: Suspect): string {
  if (low !== null && high !== null) return `${low} to ${high}`;
  return low === null ? `at most ${high}` : `at least ${low}`;
}
