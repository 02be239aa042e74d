// What a body is worth: warnings, figures of quality and words, beside those of the files around it.

import { Table, Text, Title } from "@mantine/core";

import { shown } from "../archive/text";
import type { Trial } from "./types";

export function Judgement({ trial }: { trial: Trial }) {
  if (trial.fault !== null) return null;
  const { folder, takes } = trial.around;
  const beside = takes === 0 ? "nothing to compare with: the store has no other takes" : `${takes} ${takes === 1 ? "take" : "takes"} of ${folder}`;
  return (
    <section aria-label="What the body is worth" className="doubts-judgement">
      {trial.unknown.length > 0 && <Text size="sm"><strong>Unknown:</strong> {trial.unknown.join(", ")}</Text>}
      {trial.estimated.length > 0 && <Text size="sm"><strong>Estimated:</strong> {trial.estimated.join(", ")}</Text>}
      {trial.warnings.length > 0 && (
        <>
          <Title order={3}>Warnings</Title>
          <ul className="doubts-warnings">{trial.warnings.map((one) => <li key={one}>{one}</li>)}</ul>
        </>
      )}
      <div className="doubts-tables">
        <div role="region" aria-label="Figures of quality" tabIndex={0}>
          <Title order={3}>Figures of quality</Title>
          <Text size="xs" className="muted">beside {beside}</Text>
          <Table verticalSpacing={1}>
            <Table.Thead>
              <Table.Tr><Table.Th>Figure</Table.Th><Table.Th className="number">Here</Table.Th><Table.Th>Expected</Table.Th><Table.Th>Around: median (range)</Table.Th></Table.Tr>
            </Table.Thead>
            <Table.Tbody>
              {trial.figures.filter((one) => one.value !== null).map((one) => (
                <Table.Tr key={one.figure} className={one.off ? "off" : ""}>
                  <Table.Td title={one.off ? one.advice : one.meaning}>{one.meaning}</Table.Td>
                  <Table.Td className="number">{rounded(one.value)} {one.unit}{one.off && " !"}</Table.Td>
                  <Table.Td className="muted">{one.limits}</Table.Td>
                  <Table.Td className="muted">{one.around === null ? "" : `${rounded(one.around[1])} (${rounded(one.around[0])} to ${rounded(one.around[2])})`}</Table.Td>
                </Table.Tr>
              ))}
            </Table.Tbody>
          </Table>
        </div>
        <div role="region" aria-label="Words" tabIndex={0}>
          <Title order={3}>Features on, in per cent of the frames</Title>
          <Text size="xs" className="muted">beside {beside}</Text>
          <Table verticalSpacing={1}>
            <Table.Thead>
              <Table.Tr><Table.Th>Feature</Table.Th><Table.Th className="number">Here</Table.Th><Table.Th className="number">Around</Table.Th></Table.Tr>
            </Table.Thead>
            <Table.Tbody>
              {trial.words.map((one) => (
                <Table.Tr key={one.feature}>
                  <Table.Td>{one.feature}</Table.Td>
                  <Table.Td className="number">{one.percent === null ? "unknown" : Math.round(one.percent)}</Table.Td>
                  <Table.Td className="number muted">{one.around === null ? "" : Math.round(one.around)}</Table.Td>
                </Table.Tr>
              ))}
            </Table.Tbody>
          </Table>
        </div>
      </div>
    </section>
  );
}

function rounded(value: number | null): string {
  return value === null ? "" : shown(Number(value.toPrecision(3)));
}
