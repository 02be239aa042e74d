// A second take beside the first, in step with it: along the warping path of a hit, of two intervals, or by the clock.

import { Button, Group, NativeSelect, Text, TextInput } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { type ReactNode, useCallback, useMemo, useState } from "react";

import { get } from "../api/client";
import { Fault } from "../app/Fault";
import { useParameter, useParameters } from "../app/address";
import type { Actor } from "../motion/actors";
import { clock } from "./axis";
import { useDocument, useMotion } from "./load";
import { type Pairing, partnerOf } from "./pairing";
import { Panel } from "./panels";
import type { Session } from "./session";
import type { Aligned, FittedHit, TakeDocument } from "./types";

export type Step = "hit" | "dtw" | "time";

export interface Beside {
  actors: Actor[] | null;
  frameOf: (actor: number, frame: number) => number;
  panel: ReactNode;
}

/** Return the second take that the address names, if any, and the panel that chooses it. */
export function useBeside(session: Session, document: TakeDocument, first: Actor, hit: FittedHit | undefined): Beside {
  const [name] = useParameter("beside");
  const [step] = useParameter("step");
  const [mode] = useParameter("mode");
  const [from] = useParameter("bfrom");
  const [to] = useParameter("bto");
  const other = useDocument(name);
  const found = other.data;
  const motion = useMotion(found?.take_id ?? null, document.version, session);
  const shown = session.shown.selection;
  const [interval, setInterval] = useState<readonly [number, number]>(shown ?? [0, document.frames]);
  const theirs: readonly [number, number] = [whole(from, 0), Math.min(whole(to, found?.frames ?? 1), found?.frames ?? 1)];
  const aligned = useQuery({
    queryKey: ["version", "align", document.take_id, interval, found?.take_id, theirs[0], theirs[1], document.version],
    queryFn: ({ signal }) =>
      get<Aligned>(
        `/api/align?take=${document.take_id}&start=${interval[0]}&stop=${interval[1]}` +
          `&other_take=${found?.take_id}&other_start=${theirs[0]}&other_stop=${theirs[1]}`,
        signal,
      ),
    enabled: found !== undefined && step === "dtw",
  });
  const example = step === "hit" && hit?.example?.take === name ? hit : undefined;
  const pairing = useMemo<Pairing>(() => {
    if (example?.example != null) return { start: example.start, stop: example.stop, frames: example.example.frames };
    if (step === "dtw" && aligned.data !== undefined) return aligned.data;
    const length = Math.max(1, (found?.frames ?? 1) - theirs[0]);
    const start = shown?.[0] ?? 0;
    return { start, stop: start + length, frames: Array.from({ length }, (_, i) => theirs[0] + i) };
  }, [example, step, aligned.data, found?.frames, theirs[0], shown?.[0]]);
  const begin = pairing.frames[0] ?? 0;
  const over = mode === "over";
  const actors = useMemo(
    () =>
      name === null || found === undefined
        ? null
        : [
            { ...first, stand: { x: over ? 0 : -0.75, facing: pairing.start } },
            { motion: motion.motion, second: true, stand: { x: over ? 0 : 0.75, facing: begin } },
          ],
    [name, found, first, over, pairing.start, begin, motion.motion],
  );
  const frameOf = useCallback(
    (actor: number, frame: number) => (actor === 0 ? frame : partnerOf(pairing, frame)),
    [pairing],
  );
  const fault = other.error ?? motion.fault ?? aligned.error;
  const panel = (
    <BesidePanel
      session={session}
      name={name}
      step={(step ?? "time") as Step}
      over={over}
      theirs={theirs}
      until={to}
      cost={step === "dtw" ? aligned.data?.cost : undefined}
      fault={fault}
      onAlign={() => setInterval(session.shown.selection ?? [0, document.frames])}
    />
  );
  return { actors, frameOf, panel };
}

function whole(text: string | null, absent: number): number {
  const number = Number.parseInt(text ?? "", 10);
  return Number.isFinite(number) && number >= 0 ? number : absent;
}

interface BesidePanelProps {
  session: Session;
  name: string | null;
  step: Step;
  over: boolean;
  theirs: readonly [number, number];
  until: string | null;
  cost: number | undefined;
  fault: unknown;
  onAlign: () => void;
}

function BesidePanel({ session, name, step, over, theirs, until, cost, fault, onAlign }: BesidePanelProps) {
  const set = useParameters();
  const [text, setText] = useState(name ?? "");
  const [begin, setBegin] = useState(theirs[0] > 0 ? String(theirs[0]) : "");
  const [end, setEnd] = useState(until ?? "");
  const show = () => {
    onAlign();
    set({ beside: text.trim() || null, bfrom: begin || null, bto: end || null, step: "dtw" });
  };
  return (
    <Panel title={name === null ? "Beside another take" : `Beside ${name}`} open={name !== null}>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          show();
        }}
      >
        <TextInput size="xs" label="Take" value={text} onChange={(event) => setText(event.currentTarget.value)} />
        <Group gap={6} grow mt={4}>
          <TextInput size="xs" label="From frame" inputMode="numeric" value={begin} onChange={(event) => setBegin(event.currentTarget.value)} />
          <TextInput size="xs" label="To frame" inputMode="numeric" value={end} onChange={(event) => setEnd(event.currentTarget.value)} />
        </Group>
        <Group gap={6} mt={6}>
          <Button size="compact-sm" type="submit" disabled={text.trim() === ""}>
            Show in step
          </Button>
          {name !== null && (
            <Button size="compact-sm" variant="default" onClick={() => set({ beside: null, bfrom: null, bto: null, step: null, mode: null })}>
              Alone
            </Button>
          )}
        </Group>
      </form>
      {name !== null && (
        <Group gap={6} mt={6} grow>
          <NativeSelect
            size="xs"
            label="Where"
            value={over ? "over" : "side"}
            onChange={(event) => set({ mode: event.currentTarget.value === "over" ? "over" : null })}
            data={[
              { value: "side", label: "side by side" },
              { value: "over", label: "overlaid" },
            ]}
          />
          <NativeSelect
            size="xs"
            label="In step"
            value={step}
            onChange={(event) => {
              onAlign();
              set({ step: event.currentTarget.value });
            }}
            data={[
              { value: "time", label: "by the clock" },
              { value: "dtw", label: "by DTW of words" },
              ...(step === "hit" ? [{ value: "hit", label: "by the hit's path" }] : []),
            ]}
          />
        </Group>
      )}
      {cost !== undefined && (
        <Text size="xs" className="muted">
          On average {Math.round(100 * cost)} % of the features differ along the path.
        </Text>
      )}
      {name !== null && step === "dtw" && session.shown.selection === null && (
        <Text size="xs" className="muted">
          Select an interval first to compare that alone ({clock(60, 0)} at most).
        </Text>
      )}
      {fault !== null && fault !== undefined && <Fault fault={fault} />}
    </Panel>
  );
}
