// Jobs of this start of the server, with their progress and log as they come.

import { Button, Group, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";

import { get } from "../api/client";
import { useJobs } from "../api/events";
import type { Job } from "../api/types";
import { Fault } from "../app/Fault";
import { isActive, JobProblem, JobProgress, StopButton } from "./JobControls";

const SHOWN = 5;
const LOG_MS = 1500;

/** Return a text that changes whenever a job begins or ends. */
export function useJobStamp(): string {
  return useJobs().map((one) => `${one.id} ${one.state}`).join();
}

export function Jobs({ readOnly }: { readOnly: boolean }) {
  const stamp = useJobStamp();
  const events = useJobs();
  const known = useQuery({ queryKey: ["jobs", stamp], queryFn: ({ signal }) => get<{ jobs: Job[] }>("/api/jobs", signal), placeholderData: (old) => old });
  if (known.isError) return <Fault fault={known.error} retry={() => void known.refetch()} />;
  const jobs = (known.data?.jobs ?? []).map((one) => events.find((event) => event.id === one.id) ?? one);
  if (jobs.length === 0) return null;
  return (
    <section aria-label="Jobs">
      {jobs.slice(-SHOWN).reverse().map((job) => (
        <OneJob key={job.id} job={job} readOnly={readOnly} />
      ))}
      {jobs.length > SHOWN && <Text size="sm" className="muted">The last {SHOWN} of {jobs.length} jobs; the others are in the history.</Text>}
    </section>
  );
}

function OneJob({ job, readOnly }: { job: Job; readOnly: boolean }) {
  const [open, setOpen] = useState(false);
  const [fault, setFault] = useState<unknown>(null);
  const running = isActive(job);
  const log = useQuery({
    queryKey: ["job log", job.id, job.state],
    queryFn: ({ signal }) => get<{ text: string; file: string }>(`/api/jobs/${job.id}/log`, signal),
    enabled: open,
    refetchInterval: running ? LOG_MS : false,
    placeholderData: (old) => old,
  });
  return (
    <div className="runs-job" data-testid="run-job">
      <Group gap={8}>
        <Text size="sm" role="status" style={{ flex: 1, minWidth: 0 }}>
          <strong>{job.title}</strong>: {job.state}
          {running && job.total > 0 && ` · ${job.done} of ${job.total} stages`}
          {running && job.message !== "" && ` · ${job.message}`}
        </Text>
        {!readOnly && <StopButton job={job} onFault={setFault} />}
        <Button size="compact-xs" variant="default" aria-expanded={open} onClick={() => setOpen(!open)}>
          {open ? "Hide the log" : "Show the log"}
        </Button>
      </Group>
      <JobProgress job={job} />
      <JobProblem job={job} />
      {fault !== null && <Fault fault={fault} />}
      {open && log.isError && <Fault fault={log.error} />}
      {open && log.data !== undefined && <pre className="runs-log" tabIndex={0} aria-label="Log">{log.data.text}</pre>}
    </div>
  );
}
