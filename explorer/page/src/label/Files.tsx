// Label files: written for ELAN and other tools, and read again with their differences before anything is taken in.

import { Alert, Button, Checkbox, Code, Group, NativeSelect, SegmentedControl, Table, Text, TextInput, Title } from "@mantine/core";
import { useLocalStorage } from "@mantine/hooks";
import { useState } from "react";

import { post } from "../api/client";
import type { Same } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { Titles } from "../app/Titles";

interface Written extends Same {
  files: string[];
  written: number;
  segments: number;
  takes: number;
  rejected: number;
  excluded: string[];
}

interface Difference {
  take: string;
  class: string;
  start: number;
  stop: number;
  verdict: string;
  origin: string;
  before: { class: string; start: number; stop: number; verdict: string } | null;
}

interface Shown extends Same {
  checksum: string;
  files: string[];
  known: number;
  counts: Record<string, number>;
  remarks: string[];
  total: number;
  rows: Difference[];
}

interface Taken extends Same {
  counts: Record<string, number>;
  known: number;
}

const FORMATS = [
  { value: "eaf", label: "ELAN (.eaf)" },
  { value: "csv", label: "CSV" },
  { value: "json", label: "JSON" },
  { value: "vtt", label: "WebVTT" },
  { value: "txt", label: "Audacity (.txt)" },
];

export function Files({ annotator, readOnly }: { annotator: string; readOnly: boolean }) {
  const [folder, setFolder] = useLocalStorage({ key: "kinedex-label-folder", defaultValue: "", getInitialValueInEffect: false });
  return (
    <>
      {!readOnly && <Export folder={folder} setFolder={setFolder} />}
      <Import folder={folder} setFolder={setFolder} annotator={annotator} readOnly={readOnly} />
    </>
  );
}

interface FolderProps {
  folder: string;
  setFolder: (value: string) => void;
}

function Export({ folder, setFolder }: FolderProps) {
  const [what, setWhat] = useState("annotations");
  const [format, setFormat] = useState("eaf");
  const [force, setForce] = useState(false);
  const [where, setWhere] = useParameter("only");
  const [done, setDone] = useState<Written>();
  const [fault, setFault] = useState<unknown>(null);
  useSame(done);
  const write = () => {
    setFault(null);
    post<Written>("/api/labels/export", { what, folder, format, force, where }).then(setDone, setFault);
  };
  return (
    <section aria-label="Export">
      <Title order={2}>Write label files</Title>
      <Group gap={8} align="end" my={6}>
        <SegmentedControl size="xs" aria-label="What is written" value={what} onChange={setWhat} data={[{ value: "annotations", label: "Annotations" }, { value: "labels", label: "Labels of people" }]} />
        <NativeSelect size="xs" label="Format" data={FORMATS} value={format} onChange={(event) => setFormat(event.currentTarget.value)} />
        <TextInput size="xs" w={360} label="Folder on the machine of the server" placeholder="/home/me/labels" value={folder} onChange={(event) => setFolder(event.currentTarget.value)} />
        <TextInput size="xs" w={240} label="Only takes, as SQL" placeholder="all: actor = 'ann'" value={where ?? ""} onChange={(event) => setWhere(event.currentTarget.value)} />
        <Checkbox size="xs" label="Overwrite" checked={force} onChange={(event) => setForce(event.currentTarget.checked)} />
        <Button size="compact-sm" disabled={folder.trim() === ""} onClick={write}>
          Write
        </Button>
      </Group>
      {fault !== null && <Fault fault={fault} />}
      {done !== undefined && (
        <Text size="sm" role="status">
          {done.segments} segments of {done.takes} takes in {done.written} files.
          {done.rejected > 0 && ` ${done.rejected} annotations that a person has rejected were left out.`}
          {done.excluded.length > 0 && ` Not written, since the format cannot hold their names: ${done.excluded.slice(0, 5).join(", ")}.`}
        </Text>
      )}
    </section>
  );
}

function Import({ folder, setFolder, annotator, readOnly }: FolderProps & { annotator: string; readOnly: boolean }) {
  const [corrects, setCorrects] = useState("annotations");
  const [shown, setShown] = useState<Shown | null>(null);
  const [taken, setTaken] = useState<Taken | null>(null);
  const [fault, setFault] = useState<unknown>(null);
  useSame(taken ?? shown ?? undefined);
  const question = { paths: [folder.trim()], corrects: corrects === "none" ? null : corrects };
  const read = () => {
    setFault(null);
    setTaken(null);
    setShown(null);
    post<Shown>("/api/labels/read", question).then(setShown, setFault);
  };
  const take = () => {
    setFault(null);
    post<Taken>("/api/labels/import", { ...question, checksum: shown?.checksum ?? "", annotator }).then((done) => {
      setTaken(done);
      setShown(null);
    }, setFault);
  };
  const changed = (set: (value: string) => void) => (value: string) => {
    set(value);
    setShown(null);
  };
  return (
    <section aria-label="Import">
      <Title order={2}>Take label files in</Title>
      <Text size="sm" className="muted">
        Files that were written here and corrected in ELAN or another tool, or any other label files.
      </Text>
      <Group gap={8} align="end" my={6}>
        <TextInput size="xs" w={360} label="File or folder on the machine of the server" value={folder} onChange={(event) => changed(setFolder)(event.currentTarget.value)} />
        <NativeSelect
          size="xs"
          label="They hold"
          value={corrects}
          onChange={(event) => changed(setCorrects)(event.currentTarget.value)}
          data={[
            { value: "annotations", label: "annotations that a person has corrected" },
            { value: "labels", label: "labels that a person has corrected" },
            { value: "none", label: "new labels" },
          ]}
        />
        <Button size="compact-sm" variant="default" disabled={folder.trim() === ""} onClick={read}>
          Show the differences
        </Button>
      </Group>
      {fault !== null && <Fault fault={fault} />}
      {shown !== null && <Differences shown={shown} take={take} readOnly={readOnly} />}
      {taken !== null && (
        <Text size="sm" role="status">
          Recorded: {counted(taken.counts)}.
        </Text>
      )}
    </section>
  );
}

const counted = (counts: Record<string, number>) =>
  Object.entries(counts).map(([name, count]) => `${count} ${name}`).join(", ") || "nothing new";

function Differences({ shown, take, readOnly }: { shown: Shown; take: () => void; readOnly: boolean }) {
  return (
    <>
      <Text size="sm" role="status">
        {shown.files.length} files. They would record: {counted(shown.counts)}; {shown.known} are known.
      </Text>
      {shown.remarks.map((one) => (
        <Alert key={one} color="yellow" variant="light" my={4}>
          {one}
        </Alert>
      ))}
      {shown.total > 0 && (
        <div style={{ maxHeight: 360, overflow: "auto" }}>
          <Table verticalSpacing={3} stickyHeader>
            <Titles of={["Take", "Decision", "Class", "Frames", "Before"]} />
            <Table.Tbody>
              {shown.rows.slice(0, 300).map((one, i) => (
                <Table.Tr key={i}>
                  <Table.Td>{one.take}</Table.Td>
                  <Table.Td>{one.verdict === "negative" ? "rejected" : one.verdict === "withdrawn" ? "removed" : one.origin}</Table.Td>
                  <Table.Td>{one.class}</Table.Td>
                  <Table.Td>
                    <Code>
                      [{one.start}:{one.stop}]
                    </Code>
                  </Table.Td>
                  <Table.Td>{one.before === null ? "" : `${one.before.class} [${one.before.start}:${one.before.stop}]`}</Table.Td>
                </Table.Tr>
              ))}
            </Table.Tbody>
          </Table>
          {shown.total > 300 && (
            <Text size="sm" className="muted">
              The first 300 of {shown.total} rows.
            </Text>
          )}
        </div>
      )}
      {!readOnly && (
        <Button size="compact-sm" mt={6} onClick={take} disabled={shown.total === 0}>
          Take them in
        </Button>
      )}
    </>
  );
}
