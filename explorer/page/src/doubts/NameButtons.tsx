// The joints and landmarks that a node can be, by side, and the names that were given.

import { Button, Text, Title } from "@mantine/core";

import { useStore } from "../api/queries";
import { bySide } from "./scene";
import type { Named, NodeGuess } from "./types";

interface Props {
  node: NodeGuess | undefined;
  names: string[];
  named: Named;
  /** Called with a name for the node, or with null to leave it to the recogniser. */
  onName: (name: string | null) => void;
}

export function NameButtons({ node, names, named, onName }: Props) {
  const joints = new Set(useStore().data?.joints ?? []);
  const groups = [
    { title: "Joints", names: names.filter((name) => joints.has(name)) },
    { title: "Landmarks on the skin", names: names.filter((name) => !joints.has(name)) },
  ].filter((group) => group.names.length > 0);
  if (node === undefined)
    return <Text size="sm" className="muted">Click a point of the picture, or a node of the table, and say which joint or landmark it is.</Text>;
  const given = named[node.node];
  const owners = new Map(Object.entries(named).map(([owner, name]) => [name, owner]));
  return (
    <section aria-label="Names" className="doubts-names">
      <Title order={3}>{node.node}</Title>
      <Text size="sm">
        {node.name === "" ? "Taken for nothing" : <>Taken for <strong>{node.name}</strong></>}: {node.reason}
      </Text>
      <div className="doubts-none-buttons">
        <Button size="compact-xs" variant={given === "none" ? "filled" : "default"} aria-pressed={given === "none"} onClick={() => onName("none")}>
          neither
        </Button>
        <Button size="compact-xs" variant="default" disabled={given === undefined} onClick={() => onName(null)}>
          as recognised
        </Button>
      </div>
      {groups.map((group) => (
        <div key={group.title} role="group" aria-label={group.title}>
          <Text size="xs" fw={600} mt={6}>{group.title}</Text>
          <div className="doubts-sides">
            {Object.entries(bySide(group.names)).map(([side, those]) => (
              <div key={side} className={side}>
                {those.map((name) => (
                  <button key={name} type="button" aria-pressed={given === name} title={owners.has(name) ? `${owners.get(name)} is named so` : undefined} className={owners.has(name) ? "taken" : ""} onClick={() => onName(name)}>
                    {name}
                  </button>
                ))}
              </div>
            ))}
          </div>
        </div>
      ))}
    </section>
  );
}
