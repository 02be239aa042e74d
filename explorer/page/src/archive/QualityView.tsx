import { Loader, Table, Text, Title } from "@mantine/core";
import { Link } from "wouter";

import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useQuality } from "./questions";
import { takesWhere as where } from "./selection";
import { count, counted, shown } from "./text";

/** Takes with figures beyond their limits, with warnings, and with invalid frames; each leads to its takes. */
export function QualityView() {
  const quality = useQuality();
  useSame(quality.data);
  if (quality.isError) return <Fault fault={quality.error} />;
  if (quality.data === undefined) return <Loader size="sm" aria-label="Loading" />;
  const { figures, warnings, invalid } = quality.data;
  return (
    <div className="sheet">
      <Title order={2}>Suspect takes</Title>
      {figures.length === 0 ? (
        <Text size="sm" className="muted">
          No take has a figure beyond its limits.
        </Text>
      ) : (
        <Table verticalSpacing={4} layout="auto">
          <Table.Thead>
            <Table.Tr>
              <Table.Th>Figure</Table.Th>
              <Table.Th>Expected</Table.Th>
              <Table.Th className="number">Takes</Table.Th>
              <Table.Th>What to do</Table.Th>
            </Table.Tr>
          </Table.Thead>
          <Table.Tbody>
            {figures.map((one) => (
              <Table.Tr key={one.figure}>
                <Table.Td>
                  <Link href={suspects(one.figure)}>{one.meaning}</Link> <span className="muted">{one.figure}</span>
                </Table.Td>
                <Table.Td>
                  {limits(one.low, one.high)} {one.unit}
                </Table.Td>
                <Table.Td className="number">{count(one.takes)}</Table.Td>
                <Table.Td>{one.advice}</Table.Td>
              </Table.Tr>
            ))}
          </Table.Tbody>
        </Table>
      )}
      <Title order={2} mt="lg">
        Warnings of ingest
      </Title>
      {warnings.length === 0 ? (
        <Text size="sm" className="muted">
          No file was read with a reservation.
        </Text>
      ) : (
        <Table verticalSpacing={4}>
          <Table.Thead>
            <Table.Tr>
              <Table.Th>Warning</Table.Th>
              <Table.Th className="number">Takes</Table.Th>
            </Table.Tr>
          </Table.Thead>
          <Table.Tbody>
            {warnings.map((one) => (
              <Table.Tr key={one.warning}>
                <Table.Td>
                  <Link href={where(`list_contains(warnings, ${quoted(one.warning)})`)}>{one.warning}</Link>
                </Table.Td>
                <Table.Td className="number">{count(one.takes)}</Table.Td>
              </Table.Tr>
            ))}
          </Table.Tbody>
        </Table>
      )}
      <Title order={2} mt="lg">
        Invalid frames
      </Title>
      <Text size="sm">
        {invalid.takes === 0 ? (
          <span className="muted">All frames of all takes have a word.</span>
        ) : (
          <Link href={where("invalid_frames > 0")}>
            {counted(invalid.takes, "take")} with {counted(invalid.frames, "frame")} in which joints were not seen
          </Link>
        )}
      </Text>
    </div>
  );
}

function suspects(figure: string): string {
  return where(`take_id IN (SELECT take_id FROM suspect_takes WHERE figure = ${quoted(figure)})`);
}

function quoted(text: string): string {
  return `'${text.replaceAll("'", "''")}'`;
}

function limits(low: number | null, high: number | null): string {
  if (low === null) return `at most ${shown(high)}`;
  return high === null ? `at least ${shown(low)}` : `${shown(low)} to ${shown(high)}`;
}
