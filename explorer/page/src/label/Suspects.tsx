// Labels that are probably wrong, the most suspect first, each beside what fits better.

import { Button, Loader, MultiSelect, Table, Text } from "@mantine/core";
import { Link } from "wouter";

import { useJsonParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { SmallFigure } from "../motion/SmallFigure";
import { decide } from "./decisions";
import { type Change, newId } from "./edits";
import { type Suspect, useClassNames, useLabelFacts, useSuspects } from "./load";

const NO_NAMES: string[] = [];

const KINDS = { class: "class", side: "side of the body", edges: "edges", rate: "frames a second" };

export function Suspects({ annotator, readOnly }: { annotator: string; readOnly: boolean }) {
  const facts = useLabelFacts().data;
  const names = useClassNames();
  const [classes, setClasses] = useJsonParameter<string[]>("classes", NO_NAMES);
  const found = useSuspects(classes, facts?.decisions);
  useSame(found.data);
  if (found.error !== null) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return <Loader size="sm" aria-label="Labels are being compared with each other" />;
  const { rows, total, judged, remarks } = found.data;
  return (
    <section aria-label="Labels that are probably wrong">
      <MultiSelect
        size="xs"
        w={260}
        label="Classes"
        placeholder={classes.length === 0 ? "all" : ""}
        searchable
        clearable
        data={names}
        value={classes}
        onChange={(value) => setClasses(value.length === 0 ? null : value)}
      />
      <Text size="sm" my={6} aria-live="polite" data-testid="suspect-counts">
        {judged === 0
          ? "No label can be judged: a class needs labels, or takes with this class, of two takes at least."
          : `Of ${judged.toLocaleString("en")} labels and takes with a class, ${total.toLocaleString("en")} are fitted better by something else; the first are the most suspect.`}
      </Text>
      {remarks.map((one) => (
        <Text key={one} size="sm" className="muted">
          {one}
        </Text>
      ))}
      {rows.length > 0 && (
        <Table aria-label="Labels that are probably wrong, the most suspect first">
          <Table.Thead>
            <Table.Tr>
              <Table.Th>Label</Table.Th>
              <Table.Th>What is doubtful</Table.Th>
              <Table.Th>What fits better</Table.Th>
              <Table.Th title="How much better it fits than the best other explanation does usually in this class, in spreads of the class">Suspicion</Table.Th>
              <Table.Th title="The probability of the class, by the labels of other takes">Probability</Table.Th>
              <Table.Th />
            </Table.Tr>
          </Table.Thead>
          <Table.Tbody>
            {rows.map((row) => (
              <SuspectRow key={`${row.take_id}/${row.class}/${row.start}/${row.stop}`} row={row} annotator={annotator} readOnly={readOnly} />
            ))}
          </Table.Tbody>
        </Table>
      )}
    </section>
  );
}

function SuspectRow({ row, annotator, readOnly }: { row: Suspect; annotator: string; readOnly: boolean }) {
  const change = changeOf(row);
  return (
    <Table.Tr>
      <Table.Td>
        <Link href={`/label?take=${encodeURIComponent(row.take)}&from=${row.start}&to=${row.stop}`} title="Open its lanes">
          <SmallFigure item={row} width={104} height={108} label={`${row.take}, frames ${row.start} to ${row.stop}`} />
          <div>
            {row.class} · {row.take} [{row.start}:{row.stop}]
          </div>
        </Link>
      </Table.Td>
      <Table.Td>{KINDS[row.kind]}</Table.Td>
      <Table.Td>
        {row.new_start !== null && row.new_stop !== null && (
          <SmallFigure item={{ take_id: row.take_id, start: row.new_start, stop: row.new_stop }} width={104} height={108} />
        )}
        <div>{row.proposal}</div>
      </Table.Td>
      <Table.Td>{row.suspicion.toFixed(1)}</Table.Td>
      <Table.Td>{Math.round(100 * row.probability)} %</Table.Td>
      <Table.Td>
        {row.id === null ? (
          <Text size="xs" className="muted">
            the class of the take
          </Text>
        ) : (
          change !== null && (
            <Button size="compact-sm" variant="default" disabled={readOnly} onClick={() => decide(row.take, [change], annotator)}>
              Change it
            </Button>
          )
        )}
      </Table.Td>
    </Table.Tr>
  );
}

/** Return the change of a label that makes it what fits better; null where no change of a label does. */
function changeOf(row: Suspect): Change | null {
  if (row.id === null) return null;
  if (row.new_start !== null && row.new_stop !== null)
    return { do: "change", id: newId(), label: row.id, start: row.new_start, stop: row.new_stop };
  return row.new_class === null ? null : { do: "change", id: newId(), label: row.id, class: row.new_class };
}
