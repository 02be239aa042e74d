import { Anchor, Loader, Table, Text, TextInput, Title } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { useQuery } from "@tanstack/react-query";
import { Link } from "wouter";

import { post } from "../api/client";
import type { TakesBlock } from "../api/types";
import { takeAddress, useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { Titles } from "../app/Titles";
import { counted } from "../archive/text";
import { clock } from "./axis";

const MOST = 100;

/** The page of no take: a list to choose one from. */
export function ChooseTake() {
  const [text, setText] = useParameter("name");
  const [wanted] = useDebouncedValue(text ?? "", 150);
  const takes = useQuery({
    queryKey: ["version", "choose", wanted],
    queryFn: ({ signal }) =>
      post<TakesBlock>(
        "/api/takes",
        {
          filters: wanted === "" ? [] : [{ column: "name", contains: wanted }],
          columns: ["name", "class", "actor", "seconds"],
          limit: MOST,
        },
        signal,
      ),
  });
  useSame(takes.data);
  return (
    <div className="page">
      <Title order={1}>Take</Title>
      <TextInput
        mt="xs"
        maw={420}
        label="Name of a take"
        value={text ?? ""}
        onChange={(event) => setText(event.currentTarget.value)}
      />
      {takes.isError && <Fault fault={takes.error} />}
      {takes.isPending && <Loader size="sm" m="md" aria-label="Looking for takes" />}
      {takes.data !== undefined && (
        <>
          <Text size="sm" className="muted" my={6} aria-live="polite">
            {counted(takes.data.total, "take")}
            {takes.data.total > MOST ? `, the first ${MOST} are listed; the Archive lists all` : ""}
          </Text>
          <Table verticalSpacing={3} maw={760} highlightOnHover>
            <Titles of={["Name", "Class", "Actor", "Length"]} />
            <Table.Tbody>
              {takes.data.rows.map(([name, label, actor, seconds]) => (
                <Table.Tr key={String(name)}>
                  <Table.Td>
                    <Anchor component={Link} href={takeAddress(String(name))} size="sm">
                      {String(name)}
                    </Anchor>
                  </Table.Td>
                  <Table.Td>{label === null ? "" : String(label)}</Table.Td>
                  <Table.Td>{actor === null ? "" : String(actor)}</Table.Td>
                  <Table.Td className="number">{clock(Number(seconds))}</Table.Td>
                </Table.Tr>
              ))}
            </Table.Tbody>
          </Table>
        </>
      )}
    </div>
  );
}
