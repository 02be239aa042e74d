// What becomes of verdicts and questions: labels of a class, a template, a query, a list of intervals.

import { Autocomplete, Button, Group, Menu, Text } from "@mantine/core";
import { notifications } from "@mantine/notifications";
import { useState } from "react";
import { Link } from "wouter";

import { ApiError, post } from "../api/client";
import { useStore } from "../api/queries";
import { asked, type Hit, type Interval } from "./types";
import { useVerdicts } from "./verdicts";

export interface SaveBarProps {
  hits: readonly Hit[];
  /** Offers the question as a file: its title, and a function that returns its name and text. */
  file?: { title: string; load: () => Promise<{ name: string; text: string }> };
  /** Begins the next question: more like what was accepted, less like what was rejected. */
  onRefine?: (accepted: Interval[], rejected: Interval[]) => void;
}

export function SaveBar({ hits, file, onRefine }: SaveBarProps) {
  const store = useStore().data;
  const verdicts = useVerdicts();
  const [name, setName] = useState("");
  const [saving, setSaving] = useState(false);
  const { accepted, rejected } = verdicts;
  const decided = accepted.length + rejected.length;

  const save = async () => {
    setSaving(true);
    try {
      const body = { class: name.trim(), positives: accepted.map(asked), negatives: rejected.map(asked) };
      const done = await post<{ recorded: number; known: number }>("/api/ask/labels", body);
      notifications.show({
        message: `${done.recorded} labels of ${name.trim()} are saved${done.known > 0 ? `; ${done.known} were there already` : ""}`,
      });
    } catch (fault) {
      failed(fault);
    } finally {
      setSaving(false);
    }
  };
  const saveFile = async () => {
    try {
      const { name: called, text } = await (file as NonNullable<typeof file>).load();
      download(`${called}.yaml`, text, "text/yaml");
    } catch (fault) {
      failed(fault);
    }
  };
  const chosen: readonly Interval[] = accepted.length > 0 ? accepted : hits;
  return (
    <Group gap={8} className="save-bar" role="toolbar" aria-label="What to do with the hits">
      <Text size="sm" role="status">
        {accepted.length} accepted, {rejected.length} rejected
      </Text>
      {onRefine !== undefined && (
        <Button size="compact-sm" disabled={accepted.length === 0} onClick={() => onRefine(accepted, rejected)}>
          More like these{rejected.length > 0 ? ", less like those" : ""}
        </Button>
      )}
      <Button size="compact-sm" variant="default" disabled={decided === 0} onClick={verdicts.clear}>
        Forget verdicts
      </Button>
      <span className="save-class">
        <Autocomplete
          size="xs"
          aria-label="Class of the accepted hits"
          placeholder="class"
          data={store?.classes ?? []}
          value={name}
          onChange={setName}
          limit={30}
        />
        <Button
          size="compact-sm"
          variant="default"
          loading={saving}
          disabled={decided === 0 || name.trim() === "" || store?.read_only === true}
          title={store?.read_only === true ? "This explorer was started with --read-only" : undefined}
          onClick={() => void save()}
        >
          Save as labels
        </Button>
      </span>
      <Menu position="bottom-end">
        <Menu.Target>
          <Button size="compact-sm" variant="default">
            Files…
          </Button>
        </Menu.Target>
        <Menu.Dropdown>
          {file !== undefined && <Menu.Item onClick={() => void saveFile()}>{file.title}</Menu.Item>}
          <Menu.Item
            disabled={chosen.length === 0}
            onClick={() => download("ranges.csv", rangesOf(chosen, name.trim()), "text/csv")}
          >
            {accepted.length > 0 ? "Accepted" : "Shown"} intervals (ranges.csv, for kinedex export --ranges)
          </Menu.Item>
          <Menu.Item component={Link} href={exportAddress(chosen, name.trim())}>
            Data set of the {accepted.length > 0 ? "accepted" : "shown"} hits: go to Export
          </Menu.Item>
        </Menu.Dropdown>
      </Menu>
    </Group>
  );
}

/** Most hits that an address holds; servers refuse longer addresses. */
const MOST_HITS = 200;

/** Return the address of Export with intervals; beyond what an address holds, it asks for the file of intervals. */
export function exportAddress(intervals: readonly Interval[], label: string): string {
  if (intervals.length === 0) return label === "" ? "/export" : `/export?what=labels&class=${encodeURIComponent(label)}`;
  if (intervals.length > MOST_HITS) return "/export?what=ranges";
  const hits = intervals.map(({ take, start, stop }) => ({ take, start, stop, ...(label === "" ? {} : { class: label }) }));
  return `/export?${new URLSearchParams({ hits: JSON.stringify(hits) }).toString()}`;
}

function failed(fault: unknown): void {
  const message = fault instanceof Error ? fault.message : String(fault);
  notifications.show({ color: "red", title: fault instanceof ApiError ? fault.type : "Error", message });
}

/** Return intervals as CSV. A text that a spreadsheet would take for a formula gets an apostrophe in front. */
export function rangesOf(intervals: readonly Interval[], label: string): string {
  const cell = (text: string) => {
    const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
    return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  };
  const head = label === "" ? "take,start,stop" : "take,start,stop,class";
  const rows = intervals.map((one) => [cell(one.take), one.start, one.stop, ...(label === "" ? [] : [cell(label)])].join(","));
  return [head, ...rows, ""].join("\n");
}

/** Hand a text to the browser as a file. */
export function download(name: string, text: string, type: string): void {
  const address = URL.createObjectURL(new Blob([text], { type }));
  const link = document.createElement("a");
  link.href = address;
  link.download = name.replaceAll(/[^\p{L}\p{N}._ -]/gu, "_");
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}
