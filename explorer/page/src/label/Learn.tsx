// Learn again from the labels: what it would use, the run in the background, what it changed, and the way back.

import { Anchor, Button, Code, Group, NumberInput, SegmentedControl, Select, Switch, Table, Text, TextInput, Title } from "@mantine/core";
import { useLocalStorage } from "@mantine/hooks";
import { useQuery } from "@tanstack/react-query";
import { useEffect, useState } from "react";
import { Link } from "wouter";

import { get, post } from "../api/client";
import { useJobs } from "../api/events";
import { useStore } from "../api/queries";
import type { Job, Same } from "../api/types";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { Titles } from "../app/Titles";
import { isActive, JobProblem, JobProgress, StopButton } from "../runs/JobControls";
import { type LabelFacts, useLabelFacts } from "./load";

interface LearnFacts extends Same {
  based_on: string | null;
  examples: "labels" | "clips and labels";
  method: string;
  where: string;
  last: { before: number; after: number; stage: string | null; undone: boolean } | null;
}

interface Changed {
  take: string;
  class: string;
  start: number;
  stop: number;
  change: "added" | "removed" | "moved" | "renamed";
  before: { class: string; start: number; stop: number } | null;
}

interface Changes {
  counts: Record<string, number>;
  takes: number;
  total: number;
  rows: Changed[];
}

interface Settings {
  examples: string | null;
  method: string | null;
  where: string | null;
}

const OURS = ["Learn again", "Undo what was learned"];

/** Return the last job of learning again, with its progress as it comes. */
function useLearningJob(): Job | undefined {
  const events = useJobs();
  const stamp = events.map((one) => `${one.id} ${one.state}`).join();
  const known = useQuery({ queryKey: ["jobs", stamp], queryFn: ({ signal }) => get<{ jobs: Job[] }>("/api/jobs", signal), placeholderData: (old) => old });
  const ours = known.data?.jobs.filter((one) => OURS.includes(one.title)).at(-1);
  const live = events.find((one) => one.id === ours?.id);
  return live ?? ours;
}

/** Learn again by itself after so many decisions; nothing is shown. */
export function LearnBySelf() {
  const facts = useLabelFacts().data;
  const { every, since, setSince } = useBySelf();
  const job = useLearningJob();
  const decisions = facts?.decisions;
  useEffect(() => {
    if (every === 0 || decisions === undefined || isActive(job) || decisions - since < every) return;
    setSince(decisions);
    post("/api/learn", {}).catch(() => undefined); // another tab was first, or the page shows why not
  }, [every, decisions, since, job, setSince]);
  return null;
}

function useBySelf() {
  const [every, setEvery] = useLocalStorage({ key: "kinedex-learn-every", defaultValue: 0, getInitialValueInEffect: false });
  const [since, setSince] = useLocalStorage({ key: "kinedex-learn-since", defaultValue: 0, getInitialValueInEffect: false });
  return { every, setEvery, since, setSince };
}

export function Learn({ readOnly }: { readOnly: boolean }) {
  const version = useStore().data?.version;
  const facts = useLabelFacts().data;
  const job = useLearningJob();
  const learn = useQuery({
    queryKey: ["version", "learn", version, job?.state],
    queryFn: ({ signal }) => get<LearnFacts>("/api/learn", signal),
    placeholderData: (old) => old,
  });
  useSame(learn.data);
  if (learn.isError) return <Fault fault={learn.error} retry={() => void learn.refetch()} />;
  return (
    <>
      <Title order={2}>Learn from the labels</Title>
      {facts !== undefined && <Since facts={facts} />}
      {learn.data !== undefined && !readOnly && <Begin key={learn.data.based_on} learn={learn.data} busy={isActive(job)} labels={facts?.labels ?? 0} />}
      {!readOnly && <BySelf decisions={facts?.decisions ?? 0} />}
      {job !== undefined && <Running job={job} readOnly={readOnly} />}
      {learn.data?.last != null && !isActive(job) && <Outcome key={learn.data.last.after} last={learn.data.last} readOnly={readOnly} />}
    </>
  );
}

function Since({ facts }: { facts: LabelFacts }) {
  const { stage, finished, since } = facts.learned;
  return (
    <Text size="sm" my={4}>
      {stage === null
        ? "Nothing has been annotated in this store yet: the labels of people are all that is known."
        : `${since.toLocaleString("en")} decisions since the templates of ${stage} were learned (${finished?.slice(0, 16).replace("T", " ")}).`}
    </Text>
  );
}

function Begin({ learn, busy, labels }: { learn: LearnFacts; busy: boolean; labels: number }) {
  const [settings, set] = useState<Settings>({ examples: null, method: null, where: null });
  const [fault, setFault] = useState<unknown>(null);
  const begin = () => {
    setFault(null);
    post("/api/learn", settings).catch(setFault);
  };
  return (
    <section aria-label="Settings">
      <Group gap={10} align="end" my={6}>
        <div>
          <Text size="xs" fw={600}>
            Examples
          </Text>
          <SegmentedControl
            size="xs"
            aria-label="Examples"
            value={settings.examples ?? learn.examples}
            onChange={(examples) => set({ ...settings, examples })}
            data={[
              { value: "labels", label: "Labels alone" },
              { value: "clips and labels", label: "Clips and labels" },
            ]}
          />
        </div>
        <Select
          size="xs"
          w={110}
          label="Method"
          allowDeselect={false}
          value={settings.method ?? learn.method}
          onChange={(method) => set({ ...settings, method })}
          data={["best", "numeric", "thesis"]}
        />
        <TextInput
          size="xs"
          w={340}
          label="Takes to annotate, as SQL"
          value={settings.where ?? learn.where}
          onChange={(event) => set({ ...settings, where: event.currentTarget.value })}
        />
        <Button size="compact-sm" onClick={begin} disabled={busy || labels === 0} title={labels === 0 ? "There are no labels yet" : undefined}>
          Learn and annotate
        </Button>
      </Group>
      <Text size="xs" className="muted">
        {learn.based_on === null ? "A new pipeline, learn-again." : `All other settings are those of ${learn.based_on}. The results are those of the pipeline learn-again; others stay.`}
      </Text>
      {fault !== null && <Fault fault={fault} />}
    </section>
  );
}

function BySelf({ decisions }: { decisions: number }) {
  const { every, setEvery, setSince } = useBySelf();
  return (
    <Group gap={8} my={6}>
      <Switch
        size="xs"
        label="Learn by itself after"
        checked={every > 0}
        onChange={(event) => {
          setSince(decisions);
          setEvery(event.currentTarget.checked ? 20 : 0);
        }}
      />
      <NumberInput
        size="xs"
        w={80}
        aria-label="Decisions after which it is learned again"
        min={1}
        allowDecimal={false}
        disabled={every === 0}
        value={every === 0 ? 20 : every}
        onChange={(value) => typeof value === "number" && value >= 1 && setEvery(value)}
      />
      <Text size="sm">decisions, while this page is open</Text>
    </Group>
  );
}

function Running({ job, readOnly }: { job: Job; readOnly: boolean }) {
  const [log, setLog] = useState<string | null>(null);
  const [fault, setFault] = useState<unknown>(null);
  const running = isActive(job);
  useEffect(() => setLog(null), [job.id, job.state]);
  const show = () => get<{ text: string }>(`/api/jobs/${job.id}/log`).then((found) => setLog(found.text), setFault);
  return (
    <section aria-label="Run">
      <Text size="sm" role="status" data-testid="job">
        {job.title}: {job.state}
        {running && job.message !== "" && ` · ${job.message}`}
      </Text>
      <JobProgress job={job} />
      <JobProblem job={job} />
      {fault !== null && <Fault fault={fault} />}
      <Group gap={6} my={4}>
        {!readOnly && <StopButton job={job} onFault={setFault} />}
        <Button size="compact-xs" variant="default" onClick={() => (log === null ? void show() : setLog(null))}>
          {log === null ? "Show the log" : "Hide the log"}
        </Button>
      </Group>
      {log !== null && <pre className="label-log" tabIndex={0} aria-label="Log">{log}</pre>}
    </section>
  );
}

const CHANGES = { added: "new", removed: "gone", moved: "moved", renamed: "other class" } as const;
const SHOWN = 300;

function Outcome({ last, readOnly }: { last: NonNullable<LearnFacts["last"]>; readOnly: boolean }) {
  const changes = useQuery({
    queryKey: ["learned", last.before, last.after],
    queryFn: ({ signal }) => get<Changes>("/api/learn/changes", signal),
  });
  const [fault, setFault] = useState<unknown>(null);
  if (changes.isError) return <Fault fault={changes.error} />;
  if (changes.data === undefined) return null;
  const { counts, takes, total, rows } = changes.data;
  const counted = Object.entries(CHANGES).flatMap(([key, word]) => ((counts[key] ?? 0) > 0 ? [`${counts[key]} ${word}`] : [])).join(", ");
  return (
    <section aria-label="Changes">
      <Group gap={8} mt={8}>
        <Title order={2}>What changed</Title>
        {last.undone ? (
          <Text size="sm">It was undone.</Text>
        ) : (
          !readOnly && (
            <Button size="compact-sm" variant="default" onClick={() => post("/api/learn/undo", {}).catch(setFault)}>
              Bring the annotations of version {last.before} back
            </Button>
          )
        )}
      </Group>
      {fault !== null && <Fault fault={fault} />}
      <Text size="sm" my={4} data-testid="changes">
        {total === 0 ? "No annotation differs." : `Annotations in ${takes} takes: ${counted}.`}
      </Text>
      {rows.length > 0 && (
        <div style={{ maxHeight: 420, overflow: "auto" }} tabIndex={0} role="region" aria-label="Annotations that differ">
          <Table verticalSpacing={3} stickyHeader maw={900}>
            <Titles of={["Change", "Take", "Class", "Frames", "Before"]} />
            <Table.Tbody>
              {rows.slice(0, SHOWN).map((one, i) => (
                <Table.Tr key={i}>
                  <Table.Td>{CHANGES[one.change]}</Table.Td>
                  <Table.Td>
                    <Anchor size="sm" component={Link} href={`/label?take=${encodeURIComponent(one.take)}&from=${one.start}&to=${one.stop}`}>
                      {one.take}
                    </Anchor>
                  </Table.Td>
                  <Table.Td>{one.class}</Table.Td>
                  <Table.Td>
                    <Code>
                      [{one.start}:{one.stop}]
                    </Code>
                  </Table.Td>
                  <Table.Td>{one.before !== null && one.change !== "removed" ? `${one.before.class} [${one.before.start}:${one.before.stop}]` : ""}</Table.Td>
                </Table.Tr>
              ))}
            </Table.Tbody>
          </Table>
          {total > Math.min(rows.length, SHOWN) && (
            <Text size="sm" className="muted">
              The first {Math.min(rows.length, SHOWN)} of {total.toLocaleString("en")}.
            </Text>
          )}
        </div>
      )}
    </section>
  );
}
