// The folder, the job that writes into it, and what it has written.

import { Button, Code, Group, Text, TextInput, Title } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";

import { get, post } from "../api/client";
import { useJobs } from "../api/events";
import type { Job } from "../api/types";
import { Fault } from "../app/Fault";
import { JobProgress, StopButton } from "../runs/JobControls";
import { bytesText, type Written } from "./types";

interface WritingProps {
  folder: string;
  setFolder: (folder: string) => void;
  body: Record<string, unknown>;
  /** The state of the store in the plan that is shown; null while there is none. */
  planned: string | null;
  last: Job | null;
  readOnly: boolean;
}

export function Writing({ folder, setFolder, body, planned, last, readOnly }: WritingProps) {
  const [started, setStarted] = useState<Job | null>(null);
  const [fault, setFault] = useState<unknown>(null);
  const known = started ?? last;
  const live = useJobs().find((one) => one.id === known?.id);
  const job = live ?? known;
  const active = job?.state === "waiting" || job?.state === "running";
  const write = () => {
    setFault(null);
    post<Job>("/api/export", { ...body, planned }).then(setStarted, setFault);
  };
  return (
    <section aria-label="Write">
      <Title order={2} mt={8}>
        Write
      </Title>
      <Group gap={8} align="end" my={4}>
        <TextInput size="xs" w={380} maw="100%" label="Folder on the machine of the server" placeholder="/home/me/clips" value={folder} onChange={(event) => setFolder(event.currentTarget.value)} />
        <Button size="compact-sm" disabled={readOnly || planned === null || active || folder.trim() === ""} title={readOnly ? "This explorer was started with --read-only" : undefined} onClick={write}>
          Write
        </Button>
      </Group>
      <Text size="xs" className="muted">
        {readOnly ? "This explorer is read only: it plans, and the command below the page writes." : "A new or empty folder outside of the store, or that of an earlier export."}
      </Text>
      {fault !== null && <Fault fault={fault} />}
      {job !== null && job !== undefined && (
        <div role="status">
          <Group gap={6} my={4}>
            <Text size="sm">
              {job.state === "waiting" ? "Waits for the job before it." : job.state === "running" ? job.message || "Writing …" : job.state === "done" ? "Written." : job.state === "stopped" ? "Stopped; write again to go on." : "Failed."}
            </Text>
            {!readOnly && <StopButton job={job} onFault={setFault} />}
          </Group>
          <JobProgress job={job} />
          {job.state === "failed" && <Code block>{job.problem}</Code>}
          {job.state === "done" && <Outcome id={job.id} />}
        </div>
      )}
    </section>
  );
}

function Outcome({ id }: { id: string }) {
  const written = useQuery({ queryKey: ["written", id], queryFn: ({ signal }) => get<Written>(`/api/export/${id}`, signal) });
  if (written.isError) return <Fault fault={written.error} />;
  if (written.data === undefined) return null;
  const { folder, files, bytes, excluded, command } = written.data;
  return (
    <>
      <Text size="sm" data-testid="written">
        {files.toLocaleString("en")} files, {bytesText(bytes)}, in <Code>{folder}</Code>
        {excluded > 0 && `; ${excluded} clips could not be written, see "excluded" in dataset.json`}
      </Text>
      <Code block>{command}</Code>
    </>
  );
}
