// The plan of an export: its totals, and clips, seconds and bytes of each class of each split.

import { Alert, Table, Text } from "@mantine/core";

import { Titles } from "../app/Titles";
import { bytesText, type Plan } from "./types";

const SHOWN = 500;
const NAMES: Record<string, string> = { train: "train", val: "validation", test: "test", clips: "all" };

export function PlanTable({ plan }: { plan: Plan }) {
  const splits = Object.entries(plan.splits);
  return (
    <section aria-label="Plan">
      <Text size="sm" role="status" my={4} data-testid="plan">
        {plan.clips.toLocaleString("en")} clips of {plan.takes.toLocaleString("en")} takes, {(plan.seconds / 60).toFixed(1)} minutes, {plan.files.toLocaleString("en")} files, {bytesText(plan.bytes)}, of version {plan.version}
      </Text>
      <Text size="xs" className="muted">
        Size: {plan.estimate}.
      </Text>
      {plan.remarks.map((one) => (
        <Text key={one} size="sm" my={2}>
          {one}
        </Text>
      ))}
      {plan.earlier && (
        <Alert color="yellow" variant="light" my={4}>
          The folder has an earlier export: its clips that stay the same are kept, all others are replaced or removed.
        </Alert>
      )}
      <div style={{ maxHeight: 360, overflow: "auto" }} tabIndex={0} role="region" aria-label="Clips of each split and class">
        <Table verticalSpacing={3} stickyHeader maw={760}>
          <Titles of={["Split", "Class", "Clips", "Seconds", "Size"]} />
          <Table.Tbody>
            {splits.length > 1 &&
              splits.map(([name, one]) => (
                <Table.Tr key={name} fw={600}>
                  <Table.Td>{NAMES[name] ?? name}</Table.Td>
                  <Table.Td>all ({(one.share * 100).toFixed(1)}% of the time)</Table.Td>
                  <Table.Td>{one.clips}</Table.Td>
                  <Table.Td>{one.seconds.toFixed(1)}</Table.Td>
                  <Table.Td>{bytesText(plan.rows.filter((row) => row.split === name).reduce<number | null>((sum, row) => (sum === null || row.bytes === null ? null : sum + row.bytes), 0))}</Table.Td>
                </Table.Tr>
              ))}
            {plan.rows.slice(0, SHOWN).map((one) => (
              <Table.Tr key={`${one.split} ${one.class}`}>
                <Table.Td>{NAMES[one.split] ?? one.split}</Table.Td>
                <Table.Td>{one.class ?? "no class"}</Table.Td>
                <Table.Td>{one.clips}</Table.Td>
                <Table.Td>{one.seconds.toFixed(1)}</Table.Td>
                <Table.Td>{bytesText(one.bytes)}</Table.Td>
              </Table.Tr>
            ))}
          </Table.Tbody>
        </Table>
        {plan.rows.length > SHOWN && (
          <Text size="sm" className="muted">
            The first {SHOWN} of {plan.rows.length} rows.
          </Text>
        )}
      </div>
    </section>
  );
}
