import "./label.css";

import { Button, Group, Tabs, Text, TextInput, Title } from "@mantine/core";
import { useEffect, useState } from "react";
import { Link } from "wouter";

import { useStore } from "../api/queries";
import { useParameter } from "../app/address";
import { annotatorName, openDecisions, setAnnotatorName, step, useDecisions } from "./decisions";
import { Files } from "./Files";
import { Learn, LearnBySelf } from "./Learn";
import { useLabelFacts } from "./load";
import { Queue } from "./Queue";
import { RefusedDecisions, SavedState } from "./SavedState";
import { Suspects } from "./Suspects";
import { TakeLabels } from "./TakeLabels";

/** Labels: the queue of doubtful annotations, labels that are probably wrong, the lanes of a take, and files of other tools. */
export default function LabelPage() {
  const store = useStore().data;
  const facts = useLabelFacts().data;
  const [take] = useParameter("take");
  const [view, setView] = useParameter("view");
  const [name, setName] = useState<string | null>(null);
  const annotator = name ?? annotatorName(facts?.annotator ?? "");
  useEffect(() => {
    if (store !== undefined && !store.read_only) openDecisions(store.path);
  }, [store]);
  const rename = (value: string) => {
    setName(value);
    setAnnotatorName(value);
  };
  const shown = view === "learn" || view === "suspects" || view === "files" ? view : "queue";
  return (
    <div className="page label-page">
      <div className="label-bar">
        {take === null ? <Title order={1}>Label</Title> : <Button size="compact-sm" variant="default" component={Link} href="/label">Doubtful</Button>}
        {store?.read_only === true ? <Text size="sm">This explorer only reads: labels are shown, not changed.</Text> : <Bar annotator={annotator} rename={rename} />}
        <Text size="sm" className="muted">
          {facts !== undefined && `${counted(facts.labels, "label")} in ${counted(facts.takes, "take")}`}
        </Text>
      </div>
      <RefusedDecisions />
      {store?.read_only === false && <LearnBySelf />}
      {take !== null ? (
        <TakeLabels name={take} annotator={annotator} />
      ) : (
        <Tabs value={shown} onChange={(value) => setView(value === "queue" ? null : value, true)} keepMounted={false}>
          <Tabs.List mb={8}>
            <Tabs.Tab value="queue">Doubtful</Tabs.Tab>
            <Tabs.Tab value="suspects">Suspect</Tabs.Tab>
            <Tabs.Tab value="learn">Learn</Tabs.Tab>
            <Tabs.Tab value="files">Files</Tabs.Tab>
          </Tabs.List>
          <Tabs.Panel value="queue">
            <Queue annotator={annotator} />
          </Tabs.Panel>
          <Tabs.Panel value="suspects">
            <Suspects annotator={annotator} readOnly={store?.read_only === true} />
          </Tabs.Panel>
          <Tabs.Panel value="learn">
            <Learn readOnly={store?.read_only === true} />
          </Tabs.Panel>
          <Tabs.Panel value="files">
            <Files annotator={annotator} readOnly={store?.read_only === true} />
          </Tabs.Panel>
        </Tabs>
      )}
    </div>
  );
}

const counted = (count: number, noun: string) => `${count.toLocaleString("en")} ${noun}${count === 1 ? "" : "s"}`;

function Bar({ annotator, rename }: { annotator: string; rename: (name: string) => void }) {
  const { undo, redo } = useDecisions();
  return (
    <Group gap={8}>
      <SavedState />
      <Button size="compact-xs" variant="default" disabled={undo.length === 0} onClick={() => step("undo", annotator)} title="Ctrl and Z">
        Undo
      </Button>
      <Button size="compact-xs" variant="default" disabled={redo.length === 0} onClick={() => step("redo", annotator)} title="Ctrl, Shift and Z">
        Redo
      </Button>
      <TextInput size="xs" w={120} aria-label="Your name, which the labels bear" title="Your name, which the labels bear" placeholder="your name" maxLength={200} value={annotator} onChange={(event) => rename(event.currentTarget.value)} />
    </Group>
  );
}
