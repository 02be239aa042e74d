// One file: its points or joints as they are in it, what each is taken for, and the body that their names make.

import { Alert, Loader, NativeSelect, Slider, Table, Text, Title } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useMemo, useState } from "react";

import { post } from "../api/client";
import { useJsonParameter, useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { Judgement } from "./Judgement";
import { KeepMapping } from "./KeepMapping";
import { NameButtons } from "./NameButtons";
import { type Dot, PointScene } from "./PointScene";
import { sceneOf } from "./scene";
import type { Named, NodeGuess, Nodes, SourceFile, Trial } from "./types";

const NOBODY: Named = {};

export function FileView({ file, readOnly }: { file: SourceFile; readOnly: boolean }) {
  const [given, setNamed] = useJsonParameter<unknown>("named", NOBODY);
  const named = useMemo(() => namesIn(given), [given]);
  const [, setPerson] = useParameter("person");
  const nodes = useQuery({
    queryKey: ["version", "nodes", file, named],
    queryFn: ({ signal }) => post<Nodes>("/api/files/nodes", { file, named }, signal),
    placeholderData: (old) => old,
  });
  return (
    <section aria-label="File">
      <Title order={2}>{file.source}</Title>
      {nodes.isError && <Fault fault={nodes.error} retry={() => void nodes.refetch()} />}
      {!nodes.isError && nodes.data === undefined && <Loader size="sm" aria-label="Loading" />}
      {!nodes.isError && nodes.data?.refused != null && (
        <Alert color="orange" variant="light" title="It is refused">
          <Text size="sm" style={{ overflowWrap: "anywhere" }}>{nodes.data.refused}</Text>
        </Alert>
      )}
      {nodes.data !== undefined && !nodes.data.can_be_named && (
        <Text size="sm">Its nodes cannot be named one by one: a mapping fits all of them, or the file holds no places.</Text>
      )}
      {nodes.data !== undefined && nodes.data.persons.length > 0 && (
        <NativeSelect size="xs" label="Person" data={nodes.data.persons} value={nodes.data.person} onChange={(event) => setPerson(event.currentTarget.value, true)} />
      )}
      {nodes.data !== undefined && (
        <NodesView file={{ ...file, person: nodes.data.person }} nodes={nodes.data} named={named} setNamed={setNamed} readOnly={readOnly} />
      )}
    </section>
  );
}

interface NodesProps {
  file: SourceFile;
  nodes: Nodes;
  named: Named;
  setNamed: (named: Named | null) => void;
  readOnly: boolean;
}

function NodesView({ file, nodes, named, setNamed, readOnly }: NodesProps) {
  const [chosen, choose] = useState(-1);
  const [frame, setFrame] = useState(0);
  const [name, setName] = useState(nodes.proposed_name);
  const [onlyThis, setOnlyThis] = useState(false);
  const asked = { file, named, name, only_this: onlyThis };
  const trial = useQuery({
    queryKey: ["version", "trial", asked],
    queryFn: ({ signal }) => post<Trial>("/api/files/trial", asked, signal),
    placeholderData: (old) => old,
    enabled: nodes.can_be_named && name !== "",
  });
  const tried = Object.keys(named).length > 0 ? trial.data?.commands.slice(0, 2).join("\n") : undefined;
  useSame({ command: tried ?? nodes.command });
  const scene = useMemo(() => sceneOf(nodes.frames, nodes.up), [nodes.frames, nodes.up]);
  const dots = useMemo(() => nodes.nodes.map((one): Dot => ({ label: one.node, side: sideOf(one.name), named: one.node in named })), [nodes.nodes, named]);
  const lines = useMemo(() => linesOf(nodes.parents ?? []), [nodes.parents]);
  const node = nodes.nodes[chosen];
  const give = (given: string | null) => {
    if (node === undefined) return;
    const { [node.node]: _, ...others } = named;
    const free = Object.fromEntries(Object.entries(others).filter(([, other]) => other === "none" || other !== given));
    const next = given === null ? others : { ...free, [node.node]: given };
    setNamed(Object.keys(next).length === 0 ? null : next);
  };
  return (
    <>
      {nodes.frames.length > 0 && (
        <>
          <div className="doubts-scenes">
            <figure>
              <figcaption>As the file has it ({nodes.nodes.length} nodes, {nodes.up} up)</figcaption>
              <PointScene label="Nodes of the file; the table below lists them" scene={scene} frame={frame} dots={dots} lines={lines} chosen={chosen} onChoose={choose} />
            </figure>
            <figure>
              <figcaption>The body</figcaption>
              <Body trial={trial.data} frame={frame} />
            </figure>
          </div>
          {nodes.frames.length > 1 && (
            <Slider
              size="sm"
              min={0}
              max={nodes.frames.length - 1}
              value={frame}
              onChange={setFrame}
              label={null}
              thumbLabel="Moment of the file"
            />
          )}
        </>
      )}
      {trial.isError && <Fault fault={trial.error} />}
      <div className="doubts-naming">
        <NodeTable nodes={nodes.nodes} named={named} chosen={chosen} onChoose={choose} />
        {nodes.can_be_named && <NameButtons node={node} names={nodes.names} named={named} onName={give} />}
      </div>
      {nodes.can_be_named && (
        <KeepMapping
          asked={asked}
          trial={trial.data}
          setName={setName}
          setOnlyThis={setOnlyThis}
          readOnly={readOnly}
        />
      )}
      {trial.data !== undefined && <Judgement trial={trial.data} />}
    </>
  );
}

function Body({ trial, frame }: { trial: Trial | undefined; frame: number }) {
  const scene = useMemo(() => sceneOf(trial?.frames ?? []), [trial]);
  const dots = useMemo(() => (trial?.joints ?? []).map((joint): Dot => ({ label: joint, side: sideOf(joint) })), [trial]);
  const lines = useMemo(() => linesOf(trial?.parents ?? []), [trial]);
  if (trial?.fault != null || trial === undefined || trial.frames.length === 0)
    return <Text size="sm" className="muted doubts-none">{trial?.fault != null ? `No body yet: ${trial.fault}` : "No body yet."}</Text>;
  return <PointScene label="The body that the names make" scene={scene} frame={frame} dots={dots} lines={lines} />;
}

function NodeTable({ nodes, named, chosen, onChoose }: { nodes: NodeGuess[]; named: Named; chosen: number; onChoose: (index: number) => void }) {
  return (
    <div className="doubts-nodes" role="region" aria-label="Nodes" tabIndex={0}>
      <Table verticalSpacing={2} stickyHeader>
        <Table.Thead>
          <Table.Tr>
            <Table.Th>Node</Table.Th>
            <Table.Th>Taken for</Table.Th>
            <Table.Th>Why</Table.Th>
            <Table.Th>Joints made of it</Table.Th>
          </Table.Tr>
        </Table.Thead>
        <Table.Tbody>
          {nodes.map((one, index) => (
            <Table.Tr key={index} className={index === chosen ? "chosen" : ""}>
              <Table.Td>
                <button type="button" className="doubts-open" aria-pressed={index === chosen} onClick={() => onChoose(index)}>
                  {one.node}
                </button>
              </Table.Td>
              <Table.Td fw={one.node in named ? 700 : 400}>{one.name === "" ? "–" : one.name}</Table.Td>
              <Table.Td className="muted">{one.reason}</Table.Td>
              <Table.Td className="muted">{one.joints.join(", ")}</Table.Td>
            </Table.Tr>
          ))}
        </Table.Tbody>
      </Table>
    </div>
  );
}

/** Return the names in an address, which anybody may have written; other values than texts are left out. */
function namesIn(given: unknown): Named {
  if (typeof given !== "object" || given === null) return NOBODY;
  return Object.fromEntries(Object.entries(given).filter((pair): pair is [string, string] => typeof pair[1] === "string"));
}

/** Return the side of a joint or landmark by its name, for its colour. */
function sideOf(name: string): Dot["side"] {
  if (name === "") return "none";
  if (name.startsWith("l")) return "left";
  return name.startsWith("r") && name !== "root" ? "right" : "middle";
}

function linesOf(parents: readonly number[]): (readonly [number, number])[] {
  return parents.flatMap((parent, index) => (parent >= 0 ? [[parent, index] as const] : []));
}
