// How far a job is, and the button that stops it: as Ctrl-C does at first, and by force where it goes on nevertheless.

import { Alert, Button, Progress, Text } from "@mantine/core";

import { post } from "../api/client";
import type { Job } from "../api/types";

export const isActive = (job: Job | undefined): boolean => job?.state === "waiting" || job?.state === "running";

/** Return how much of a job is done, in per cent; null while nobody knows. */
export const percentOf = (job: Job): number | null => (job.share === null ? null : Math.floor(100 * job.share));

export function JobProgress({ job }: { job: Job }) {
  const percent = percentOf(job);
  if (job.state !== "running") return null;
  const name = percent === null ? `${job.title}: running` : `${job.title}: ${percent} %`;
  return (
    <div className="job-progress">
      <Progress value={percent ?? 100} animated aria-label={name} />
      {percent !== null && <Text size="xs">{percent} %</Text>}
    </div>
  );
}

/** Why a job failed, where it did. */
export function JobProblem({ job }: { job: Job }) {
  if (job.problem === null) return null;
  return (
    <Alert color="red" variant="light" title="It failed">
      <Text size="sm" style={{ whiteSpace: "pre-wrap", overflowWrap: "anywhere" }}>{job.problem}</Text>
    </Alert>
  );
}

export function StopButton({ job, onFault }: { job: Job; onFault: (fault: unknown) => void }) {
  if (!isActive(job)) return null;
  const force = job.stopping;
  return (
    <Button
      size="compact-xs"
      variant="default"
      title={force ? "End its processes at once; what it has not committed is lost" : "As Ctrl-C does: what was committed stays"}
      onClick={() => void post(`/api/jobs/${job.id}/stop`, { force }).catch(onFault)}
    >
      {force ? "Stop by force" : "Stop"}
    </Button>
  );
}
