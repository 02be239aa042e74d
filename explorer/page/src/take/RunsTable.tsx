// The lanes as a table, for screen readers and for those who want numbers: the runs of one lane as rows.

import { Button, NativeSelect, Table } from "@mantine/core";
import { useMemo, useState } from "react";

import type { Feature } from "../api/types";
import { Titles } from "../app/Titles";
import { frameClock } from "./axis";
import { GROUP_NAMES } from "./rows";
import type { Session } from "./session";
import type { Lane, Segment } from "./types";
import type { Words } from "./words";

const PAGE = 50;

export interface RunsTableProps {
  session: Session;
  lanes: readonly Lane[];
  features: readonly Feature[];
  words: Words | null;
}

export function RunsTable({ session, lanes, features, words }: RunsTableProps) {
  const [open, setOpen] = useState(false);
  return (
    <details className="runs" onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>Lanes as a table</summary>
      {open && <Runs session={session} lanes={lanes} features={features} words={words} />}
    </details>
  );
}

function Runs({ session, lanes, features, words }: RunsTableProps) {
  const choices = useMemo(
    () => [
      ...lanes.map((one) => ({ value: one.id, label: `${GROUP_NAMES[one.group]}: ${one.name} (${one.segments.length})` })),
      ...features.map((one) => ({ value: `feature/${one.bit}`, label: `F${one.bit + 1} ${one.name}` })),
    ],
    [lanes, features],
  );
  const [chosen, setChosen] = useState(choices[0]?.value ?? "");
  const [most, setMost] = useState(PAGE);
  const rows = useMemo<Segment[]>(() => {
    const lane = lanes.find((one) => one.id === chosen);
    if (lane !== undefined) return [...lane.segments].sort((a, b) => a.start - b.start);
    return words === null ? [] : words.runs(Number(chosen.replace("feature/", ""))).map((run) => ({ ...run }));
  }, [chosen, lanes, words]);
  const seconds = (frame: number) => frameClock(frame, session.rateHz);
  return (
    <>
      <NativeSelect
        size="xs"
        label="Lane"
        w={360}
        maw="100%"
        data={choices}
        value={chosen}
        onChange={(event) => {
          setChosen(event.currentTarget.value);
          setMost(PAGE);
        }}
      />
      <Table verticalSpacing={2} stickyHeader aria-rowcount={rows.length + 1}>
        <Table.Caption>{rows.length} runs</Table.Caption>
        <Titles of={["Begin", "End", "Frames", "Class", "Confidence", "Cost", ""]} />
        <Table.Tbody>
          {rows.slice(0, most).map((one, i) => (
            <Table.Tr key={`${one.start}-${i}`} aria-rowindex={i + 2}>
              <Table.Td className="number">{seconds(one.start)}</Table.Td>
              <Table.Td className="number">{seconds(one.stop)}</Table.Td>
              <Table.Td className="number">{one.stop - one.start}</Table.Td>
              <Table.Td>{one.class ?? "on"}</Table.Td>
              <Table.Td className="number">{one.confidence?.toFixed(2) ?? ""}</Table.Td>
              <Table.Td className="number">{one.cost?.toFixed(3) ?? ""}</Table.Td>
              <Table.Td>
                <Button
                  size="compact-xs"
                  variant="default"
                  aria-label={`Show ${seconds(one.start)} to ${seconds(one.stop)}`}
                  onClick={() => {
                    session.select([one.start, one.stop]);
                    session.seek(one.start);
                  }}
                >
                  Show
                </Button>
              </Table.Td>
            </Table.Tr>
          ))}
        </Table.Tbody>
      </Table>
      {rows.length > most && (
        <Button size="compact-sm" variant="default" onClick={() => setMost(most + 4 * PAGE)}>
          {rows.length - most} more
        </Button>
      )}
    </>
  );
}
