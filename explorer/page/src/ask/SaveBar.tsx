// What becomes of verdicts and questions: labels of a class, a template, a query, a list of intervals, a data set.

import { Autocomplete, Button, Group, Menu, Text } from "@mantine/core";
import { notifications } from "@mantine/notifications";
import { type ReactNode, useState } from "react";
import { Link } from "wouter";

import { ApiError, post } from "../api/client";
import { useStore } from "../api/queries";
import type { Same } from "../api/types";
import { useParameter } from "../app/address";
import { showSame } from "../app/same";
import { counted } from "../archive/text";
import { annotatorName } from "../label/decisions";
import { useLabelFacts } from "../label/load";
import { download, exportAddress, rangesOf } from "./files";
import { asked, type Hit, type Interval, samePlace } from "./types";
import { useVerdicts } from "./verdicts";

interface Named {
  name: string;
  text: string;
}

export interface SaveBarProps {
  hits: readonly Hit[];
  /** What was searched by, if intervals were. */
  examples?: readonly Interval[];
  /** The query that was searched by; otherwise one is proposed from the first accepted hit or example. */
  query?: Named;
  /** Begins the next question: more like what was accepted, less like what was rejected. */
  onRefine: (accepted: Interval[], rejected: Interval[]) => void;
}

const NONE: readonly Interval[] = [];

export function SaveBar({ hits, examples = NONE, query, onRefine }: SaveBarProps) {
  const store = useStore().data;
  const facts = useLabelFacts().data;
  const verdicts = useVerdicts();
  const [label, setLabel] = useParameter("class");
  const [saving, setSaving] = useState(false);
  const { accepted, rejected } = verdicts;
  const decided = accepted.length + rejected.length;
  const name = (label ?? "").trim();
  const path = store?.path ?? "STORE";
  const attempt = (action: () => Promise<void>) => () => {
    setSaving(true);
    action()
      .catch(failed)
      .finally(() => setSaving(false));
  };

  const saveLabels = attempt(async () => {
    const annotator = annotatorName(facts?.annotator ?? "") || null;
    const body = { class: name, positives: accepted.map(asked), negatives: rejected.map(asked), annotator };
    const done = await post<Same & { recorded: number; known: number }>("/api/ask/labels", body);
    if (done.command !== undefined) showSame(done);
    const before = done.known > 0 ? `; ${done.known} were there already` : "";
    tell(`${counted(done.recorded, "label")} of ${name} saved in the store${before}.`, <Link href="/label?view=learn">Learn from the labels</Link>);
  });
  /** Accepted hits, and the examples that are not among them. */
  const positives = [...examples.filter((one) => !accepted.some((other) => samePlace(one, other))), ...accepted];
  const saveTemplate = attempt(async () => {
    const body = { positives: positives.map(asked), negatives: rejected.map(asked), name: name || "example" };
    const made = await post<Named>("/api/ask/template", body);
    const file = download(`${made.name}.yaml`, made.text, "text/yaml");
    tell(`${file}: a template of ${counted(positives.length, "interval")}. To search by it: kinedex rank ${path} ${file}`);
  });
  const first = accepted[0] ?? examples[0];
  const saveQuery = attempt(async () => {
    const made = query ?? (await propose(first, name || "query"));
    const file = download(`${made.name}.yaml`, made.text, "text/yaml");
    const source = query === undefined ? `keyframes proposed from ${first?.take ?? ""}` : "the query";
    tell(`${file}: ${source}. To search by it: kinedex search ${path} ${file}`);
  });
  const chosen: readonly Interval[] = accepted.length > 0 ? accepted : hits;
  const which = accepted.length > 0 ? "accepted" : "shown";
  const saveRanges = () => {
    const file = download("ranges.csv", rangesOf(chosen, name), "text/csv");
    tell(`${file}: ${counted(chosen.length, "interval")}. To write their clips: kinedex export ${path} --ranges ${file}`);
  };
  return (
    <Group gap={8} className="save-bar" role="toolbar" aria-label="What to do with the hits">
      <Text size="sm" role="status">
        {accepted.length} accepted, {rejected.length} rejected
      </Text>
      <Button size="compact-sm" disabled={accepted.length === 0} onClick={() => onRefine(accepted, rejected)}>
        More like these{rejected.length > 0 ? ", less like those" : ""}
      </Button>
      <Button size="compact-sm" variant="default" disabled={decided === 0} onClick={verdicts.clear}>
        Forget verdicts
      </Button>
      <span className="save-class">
        <Autocomplete
          size="xs"
          aria-label="Class of the accepted hits"
          placeholder="class"
          data={facts?.classes.map((one) => one.name) ?? []}
          value={label ?? ""}
          onChange={setLabel}
          limit={30}
        />
        <Button
          size="compact-sm"
          variant="default"
          loading={saving}
          disabled={decided === 0 || name === "" || store?.read_only === true}
          title={store?.read_only === true ? "This explorer was started with --read-only" : undefined}
          onClick={saveLabels}
        >
          Save as labels
        </Button>
      </span>
      <Menu position="bottom-end">
        <Menu.Target>
          <Button size="compact-sm" variant="default">
            Save as…
          </Button>
        </Menu.Target>
        <Menu.Dropdown>
          <Menu.Item disabled={positives.length === 0} onClick={saveTemplate}>
            Template (YAML){positives.length > 0 ? ` of ${counted(positives.length, "interval")}` : ": accept a hit first"}
          </Menu.Item>
          <Menu.Item disabled={query === undefined && first === undefined} onClick={saveQuery}>
            Query (YAML){query === undefined ? `: keyframes ${first === undefined ? "; accept a hit first" : `proposed from ${first.take}`}` : ""}
          </Menu.Item>
          <Menu.Item disabled={chosen.length === 0} onClick={saveRanges}>
            Intervals (CSV) of the {which} hits
          </Menu.Item>
          <Menu.Item component={Link} href={exportAddress(chosen, name)}>
            Data set of the {which} hits: go to Export
          </Menu.Item>
        </Menu.Dropdown>
      </Menu>
    </Group>
  );
}

/** Ask for keyframes of an interval, as a query file. */
async function propose(one: Interval | undefined, name: string): Promise<Named> {
  if (one === undefined) throw new Error("accept a hit first: the query is proposed from it");
  const { take, start, stop } = one;
  const made = await post<{ text: string }>("/api/ask/propose", { take, start, stop, name });
  return { name, text: made.text };
}

function tell(message: string, link?: ReactNode): void {
  notifications.show({
    message: (
      <>
        {message} {link}
      </>
    ),
    autoClose: 10_000,
  });
}

function failed(fault: unknown): void {
  const message = fault instanceof Error ? fault.message : String(fault);
  notifications.show({ color: "red", title: fault instanceof ApiError ? fault.type : "Error", message });
}
