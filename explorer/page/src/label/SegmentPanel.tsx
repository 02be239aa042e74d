// The label or annotation that is chosen: its class and edges to correct, decisions about it, and its history.

import { Button, Group, NumberInput, Text, Title } from "@mantine/core";
import { useState } from "react";

import { frameClock } from "../take/axis";
import { ClassInput } from "./ClassInput";
import type { Edits, LabelRow } from "./edits";
import type { Item } from "./LabelLanes";
import { Why } from "./Why";

interface PanelProps {
  item: Item | null;
  rows: readonly LabelRow[];
  takeId: number;
  frames: number;
  rateHz: number;
  edits: Edits;
  readOnly: boolean;
}

export function SegmentPanel({ item, rows, takeId, frames, rateHz, edits, readOnly }: PanelProps) {
  if (item === null)
    return (
      <Text size="sm" className="muted">
        Nothing is chosen. Click a label or an annotation, or press j and k.
      </Text>
    );
  const seconds = (frame: number) => frameClock(frame, rateHz);
  return (
    <section aria-label="Chosen">
      <Title order={2} size="h3">{item.kind === "label" ? "Label" : "Annotation"}</Title>
      <Text size="sm" aria-live="polite">
        {item.text}: {seconds(item.start)} to {seconds(item.stop)}, {item.stop - item.start} frames
      </Text>
      {item.annotation !== undefined && <Deciding item={item} edits={edits} readOnly={readOnly} />}
      {item.label !== undefined && !readOnly && <Correcting label={item.label} frames={frames} edits={edits} />}
      <Why take_id={takeId} start={item.start} stop={item.stop} label={item.label?.class ?? item.annotation?.subclass ?? item.annotation?.class} />
      {item.label !== undefined && <History label={item.label} rows={rows} />}
    </section>
  );
}

function Deciding({ item, edits, readOnly }: { item: Item; edits: Edits; readOnly: boolean }) {
  const annotation = item.annotation;
  if (annotation === undefined) return null;
  return (
    <>
      <Text size="sm" className="muted">
        {item.state === "open" ? "undecided" : item.state}
        {annotation.confidence !== null && ` · confidence ${Math.round(100 * annotation.confidence)} %`}
        {annotation.cost !== null && ` · cost ${annotation.cost.toFixed(3)}`}
      </Text>
      {!readOnly && (
        <Group gap={6} my={6}>
          <Button size="compact-sm" onClick={() => edits.decide(annotation, true)} disabled={item.state === "accepted"}>
            Accept (y)
          </Button>
          <Button size="compact-sm" variant="default" onClick={() => edits.decide(annotation, false)} disabled={item.state === "rejected"}>
            Reject (n)
          </Button>
          <Button size="compact-sm" variant="default" onClick={() => edits.correct(annotation)}>
            Correct (e)
          </Button>
        </Group>
      )}
    </>
  );
}

function Correcting({ label, frames, edits }: { label: LabelRow; frames: number; edits: Edits }) {
  const [name, setName] = useState(label.class);
  const edge = (which: "start" | "stop", text: string, least: number, most: number) => (
    <NumberInput
      size="xs"
      w={110}
      label={text}
      min={least}
      max={most}
      allowDecimal={false}
      clampBehavior="strict"
      defaultValue={label[which]}
      onBlur={(event) => {
        const value = Number.parseInt(event.currentTarget.value, 10);
        if (Number.isFinite(value)) edits.change(label, { [which]: value });
      }}
      onKeyDown={(event) => event.key === "Enter" && event.currentTarget.blur()}
    />
  );
  return (
    <>
      <div data-chosen-class>
        <ClassInput label="Class" value={name} onChange={setName} onDone={(value) => edits.change(label, { class: value })} />
      </div>
      <Group gap={8} my={6} align="end">
        {edge("start", "Start", 0, label.stop - 1)}
        {edge("stop", "Stop", label.start + 1, frames)}
      </Group>
      <Group gap={6} my={6}>
        <Button size="compact-sm" variant="default" onClick={() => edits.split(label)} title="At the playhead (s)">
          Split
        </Button>
        <Button size="compact-sm" variant="default" onClick={() => edits.join(label)} title="With the next label of its class (m)">
          Join
        </Button>
        <Button
          size="compact-sm"
          variant="default"
          onClick={() => edits.change(label, { verdict: label.verdict === "positive" ? "negative" : "positive" })}
        >
          {label.verdict === "positive" ? "It is not this (n)" : "It is this (y)"}
        </Button>
        <Button size="compact-sm" variant="default" color="red" onClick={() => edits.withdraw(label)} title="Delete">
          Take back
        </Button>
      </Group>
      {label.file_changed === true && (
        <Text size="sm" fw={600}>
          ⚠ The file of the take has changed since this label was made.
        </Text>
      )}
    </>
  );
}

/** The rows that led to a label, the latest first. */
function History({ label, rows }: { label: LabelRow; rows: readonly LabelRow[] }) {
  const known = new Map(rows.map((row) => [row.id, row]));
  const found: LabelRow[] = [];
  for (let row: LabelRow | undefined = label; row !== undefined && found.length < 50; row = known.get(row.replaces ?? "")) found.push(row);
  return (
    <details className="panel">
      <summary>History ({found.length})</summary>
      <ol className="label-history">
        {found.map((row) => (
          <li key={row.id}>
            {row.verdict === "withdrawn" ? "taken back" : row.origin} {row.verdict === "negative" ? "not " : ""}
            {row.class} [{row.start}:{row.stop}]{row.annotator === null ? "" : `, ${row.annotator}`}
            {row.created === null ? ", not saved yet" : `, ${row.created.slice(0, 16).replace("T", " ")}`}
          </li>
        ))}
      </ol>
    </details>
  );
}
