// The files with a doubt of one cause, and the acceptance of doubts about takes.

import { Button, Group, Loader, Text, Title } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";
import { Link } from "wouter";

import { post } from "../api/client";
import { queries } from "../api/queries";
import type { Same } from "../api/types";
import { takeAddress, useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { showSame, useSame } from "../app/same";
import { count } from "../archive/text";
import type { Cause, DoubtRow, DoubtRows } from "./types";

export function CauseFiles({ cause, readOnly }: { cause: Cause; readOnly: boolean }) {
  const asked = { kind: cause.kind, cause: cause.cause };
  const found = useQuery({
    queryKey: ["version", "doubts", asked],
    queryFn: ({ signal }) => post<DoubtRows>("/api/doubts/files", asked, signal),
    placeholderData: (old) => old,
  });
  const [fault, setFault] = useState<unknown>(null);
  useSame(found.data);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return <Loader size="sm" aria-label="Loading" />;
  const { rows, total } = found.data;
  const accept = async (takes: string[], revoke: boolean) => {
    setFault(null);
    try {
      const done = await post<Same>("/api/doubts/accept", { ...asked, takes, revoke });
      await queries.invalidateQueries({ queryKey: ["version", "doubts"] });
      showSame(done);
    } catch (refused) {
      setFault(refused);
    }
  };
  const open = rows.some((row) => !row.accepted);
  return (
    <section aria-label="Files of this cause">
      <Title order={2}>{cause.cause}</Title>
      <Group gap={8} my={4}>
        <Text size="xs" className="muted" role="status">
          {count(total)} {total === 1 ? "file" : "files"}
          {rows.length < total && `, the first ${count(rows.length)} shown`}
        </Text>
        {cause.kind !== "refused" && !readOnly && (
          <Button size="compact-xs" variant="default" onClick={() => void accept([], !open)}>
            {open ? "Accept all" : "Accept none of them"}
          </Button>
        )}
      </Group>
      {fault !== null && <Fault fault={fault} />}
      <ul className="doubts-rows">
        {rows.map((row, index) => (
          <FileRow key={`${index} ${row.source}`} row={row} readOnly={readOnly} onAccept={accept} />
        ))}
      </ul>
    </section>
  );
}

function FileRow({ row, readOnly, onAccept }: { row: DoubtRow; readOnly: boolean; onAccept: (takes: string[], revoke: boolean) => Promise<void> }) {
  const set = useParameters();
  const [root] = useParameter("root");
  const [source] = useParameter("file");
  const [take, from] = [row.take, row.source_root];
  const shown = root === from && source === row.source;
  return (
    <li className={shown ? "shown" : ""}>
      {from === null ? (
        <Text size="sm">{row.source}</Text>
      ) : (
        <button
          type="button"
          className="doubts-open"
          aria-current={shown}
          onClick={() => set({ root: from, file: row.source, person: null, named: null }, true)}
        >
          {row.source}
        </button>
      )}
      <Text size="xs" className={`doubts-message${row.accepted ? " muted" : ""}`} title={row.message}>{row.message}</Text>
      {take !== null && (
        <Group gap={8}>
          <Link href={takeAddress(take)}>{take}</Link>
          {!readOnly && (
            <Button size="compact-xs" variant="subtle" onClick={() => void onAccept([take], row.accepted)}>
              {row.accepted ? "Accepted; take it back" : "Accept"}
            </Button>
          )}
        </Group>
      )}
    </li>
  );
}
