// Precision, recall and F of every evaluation that the store holds.

import { Table, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";

import { get } from "../api/client";
import { useStore } from "../api/queries";
import type { Same } from "../api/types";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import type { Measured } from "./types";

const MEASURES = [
  ["f1", "F (frames)"],
  ["p1", "Precision (frames)"],
  ["r1", "Recall (frames)"],
  ["f2", "F (segments)"],
  ["p2", "Precision (segments)"],
  ["r2", "Recall (segments)"],
] as const;

export function Methods() {
  const version = useStore().data?.version;
  const found = useQuery({
    queryKey: ["version", "methods", version],
    queryFn: ({ signal }) => get<Same & { rows: Measured[] }>("/api/runs/metrics", signal),
    placeholderData: (old) => old,
  });
  useSame(found.data);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return null;
  if (found.data.rows.length === 0) return <Text size="sm">Nothing has been evaluated in this store: the pipelines annotate and hdm05 compare annotations with ground truth.</Text>;
  return (
    <div className="runs-table" tabIndex={0} role="region" aria-label="Methods compared">
      <Table verticalSpacing={4} maw={1200}>
        <Table.Thead>
          <Table.Tr>
            <Table.Th>Stage</Table.Th>
            <Table.Th>Evaluation</Table.Th>
            {MEASURES.map(([key, title]) => (
              <Table.Th key={key} className="number">{title}</Table.Th>
            ))}
          </Table.Tr>
        </Table.Thead>
        <Table.Tbody>
          {found.data.rows.map((row) => (
            <Table.Tr key={`${row.pipeline}/${row.stage}/${row.evaluation}`}>
              <Table.Td>{row.pipeline}/{row.stage}</Table.Td>
              <Table.Td>{row.evaluation}</Table.Td>
              {MEASURES.map(([key]) => (
                <Table.Td key={key} className="number">{row[key]?.toFixed(3) ?? "–"}</Table.Td>
              ))}
            </Table.Tr>
          ))}
        </Table.Tbody>
      </Table>
    </div>
  );
}
