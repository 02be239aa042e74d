// Keep the mapping that names make in the store, for this file or for all alike, and read their folder again.

import { Button, Code, Group, Radio, Text, TextInput } from "@mantine/core";
import { useState } from "react";

import { post } from "../api/client";
import { useJobs } from "../api/events";
import { Fault } from "../app/Fault";
import { showSame } from "../app/same";
import { JobProblem, JobProgress } from "../runs/JobControls";
import type { Kept, Named, SourceFile, Trial } from "./types";

interface Props {
  asked: { file: SourceFile; named: Named; name: string; only_this: boolean };
  trial: Trial | undefined;
  setName: (name: string) => void;
  setOnlyThis: (only: boolean) => void;
  readOnly: boolean;
}

export function KeepMapping({ asked, trial, setName, setOnlyThis, readOnly }: Props) {
  const [kept, setKept] = useState<Kept | null>(null);
  const [fault, setFault] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const keep = async () => {
    setFault(null);
    setBusy(true);
    try {
      const done = await post<Kept>("/api/files/mapping", asked);
      setKept(done);
      showSame({ command: done.commands.join("\n") });
    } catch (refused) {
      setFault(refused);
    } finally {
      setBusy(false);
    }
  };
  const ready = trial !== undefined && trial.fault === null && Object.keys(asked.named).length > 0;
  return (
    <section aria-label="Mapping" className="doubts-keep">
      <Group gap={12} align="end">
        <TextInput size="xs" label="Name of the mapping" value={asked.name} onChange={(event) => setName(event.currentTarget.value)} />
        <Radio.Group size="xs" label="For" value={asked.only_this ? "this" : "alike"} onChange={(value) => setOnlyThis(value === "this")}>
          <Group gap={10}>
            <Radio size="xs" value="alike" label="all files with these nodes" />
            <Radio size="xs" value="this" label="files of this name only" />
          </Group>
        </Radio.Group>
        <Button size="xs" disabled={!ready || readOnly || busy} onClick={() => void keep()}>
          Keep and read again
        </Button>
      </Group>
      {readOnly && <Text size="xs" className="muted">This explorer is read-only: it shows what names make, and keeps no mapping.</Text>}
      {fault !== null && <Fault fault={fault} />}
      {kept !== null && <Progress kept={kept} />}
      {trial !== undefined && (
        <details>
          <summary>The same by commands, and the mapping</summary>
          <Code block aria-label="Commands">{trial.commands.join("\n")}</Code>
          <Code block className="doubts-yaml" aria-label="The mapping as YAML" tabIndex={0}>{trial.yaml}</Code>
        </details>
      )}
    </section>
  );
}

function Progress({ kept }: { kept: Kept }) {
  const job = useJobs().find((one) => one.id === kept.job.id) ?? kept.job;
  return (
    <div role="status">
      <Text size="sm">
        The store keeps <strong>{kept.name}</strong>{kept.replaced && ", in place of an earlier one of this name"}. {job.title}: {job.state}.
      </Text>
      <JobProgress job={job} />
      <JobProblem job={job} />
    </div>
  );
}
