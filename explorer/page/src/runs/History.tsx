// The runs of pipelines, the newest first.

import { Anchor, Badge, Table, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";

import { get } from "../api/client";
import { useStore } from "../api/queries";
import type { Same } from "../api/types";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { Titles } from "../app/Titles";
import { useJobStamp } from "./Jobs";
import { duration, moment, reportAddress } from "./text";
import type { Run } from "./types";

export function History() {
  const version = useStore().data?.version;
  const stamp = useJobStamp();
  const found = useQuery({
    queryKey: ["version", "runs", version, stamp],
    queryFn: ({ signal }) => get<Same & { runs: Run[]; total: number }>("/api/runs", signal),
    placeholderData: (old) => old,
  });
  useSame(found.data);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return null;
  const { runs, total } = found.data;
  if (total === 0) return <Text size="sm">No pipeline has run on this store yet: choose one under Pipelines.</Text>;
  return (
    <div className="runs-table" tabIndex={0} role="region" aria-label="Runs of pipelines">
      <Table verticalSpacing={4}>
        <Titles of={["Pipeline", "Outcome", "Begun", "Duration", "Version", "Stages", "Settings", "Reports"]} />
        <Table.Tbody>
          {runs.map((run) => (
            <OneRun key={run.run} run={run} />
          ))}
        </Table.Tbody>
      </Table>
      {total > runs.length && <Text size="sm" className="muted">The last {runs.length} of {total.toLocaleString("en")} runs; the command below lists all.</Text>}
    </div>
  );
}

function OneRun({ run }: { run: Run }) {
  const settings = Object.entries(run.settings);
  const skipped = run.stages.filter((one) => one.state === "up to date").length;
  return (
    <Table.Tr title={run.written_by || undefined}>
      <Table.Td>
        {run.pipeline} {run.current && (
          <Badge size="xs" variant="outline" title="The views of results show what this run has made">
            current
          </Badge>
        )}
        <Text size="xs" className="muted">{run.run}</Text>
      </Table.Td>
      <Table.Td maw={260}>
        {run.state}
        {run.problem !== null && <Text size="xs">{run.problem}</Text>}
      </Table.Td>
      <Table.Td>{moment(run.begun)}</Table.Td>
      <Table.Td className="number">{duration(run.seconds)}</Table.Td>
      <Table.Td className="number">{run.version}</Table.Td>
      <Table.Td miw={220}>
        <details>
          <summary>
            {run.stages.filter((one) => one.state === "ran").length} ran
            {skipped > 0 && `, ${skipped} up to date`}
          </summary>
          <ul className="runs-stages">
            {run.stages.map((one) => (
              <li key={one.stage}>
                <strong>{one.stage}</strong>: {one.state}
                {one.state === "ran" && `, ${duration(one.seconds)}`}
                {one.reason !== "" && ` (${one.reason})`}
              </li>
            ))}
          </ul>
        </details>
      </Table.Td>
      <Table.Td maw={260}>{settings.map(([name, value]) => `${name}=${typeof value === "string" ? value : JSON.stringify(value)}`).join(", ")}</Table.Td>
      <Table.Td>
        {run.reports.map((name) => (
          <div key={name}>
            <Anchor size="sm" href={reportAddress(name)} target="_blank" rel="noopener noreferrer">
              {name.split("/").at(-1)}
            </Anchor>
          </div>
        ))}
      </Table.Td>
    </Table.Tr>
  );
}
