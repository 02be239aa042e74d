// The settings of an export: what leaves the store, in what form, into which splits.

import { Button, Checkbox, Group, NativeSelect, TagsInput, Text, TextInput, Title } from "@mantine/core";
import type { ReactNode } from "react";

import { useStore } from "../api/queries";
import { useClassNames } from "../label/load";
import type { Facts } from "./types";
import { classesOf, type Values } from "./request";

const KINDS = [
  { value: "takes", label: "Whole takes" },
  { value: "labels", label: "Labels of people" },
  { value: "annotations", label: "Annotations" },
  { value: "hits", label: "Saved hits" },
  { value: "ranges", label: "A file of intervals" },
  { value: "sql", label: "A SQL query" },
];

const NAMED: Record<string, string> = {
  hits: "Name of the saved hits",
  ranges: "CSV file on the machine of the server",
  sql: "Query with take[, start, stop, class]",
};

interface SettingsProps {
  values: Values;
  set: (values: Record<string, string | null>) => void;
  facts: Facts;
}

export function Settings({ values, set, facts }: SettingsProps) {
  const store = useStore().data;
  const text = (key: string, label: string, width: number, placeholder = "") => (
    <TextInput size="xs" w={width} maw="100%" label={label} placeholder={placeholder} value={values[key] ?? ""} onChange={(event) => set({ [key]: event.currentTarget.value })} />
  );
  const check = (key: string, label: string) => (
    <Checkbox size="xs" label={label} checked={values[key] === "1"} onChange={(event) => set({ [key]: event.currentTarget.checked ? "1" : null })} />
  );
  const kind = values.what || "takes";
  const handed = values.hits !== "" && values.hits !== undefined;
  const classes = useClassNames();
  const chosen = classesOf(values);
  const columns = (store?.columns ?? []).map((one) => one.name);
  return (
    <>
      <Part title="What leaves the store">
        {handed ? (
          <Text size="sm">
            Hits that the page Ask has handed over.{" "}
            <Button size="compact-xs" variant="default" onClick={() => set({ hits: null })}>
              Choose something else
            </Button>
          </Text>
        ) : (
          <NativeSelect size="xs" label="Clips" data={KINDS} value={kind} onChange={(event) => set({ what: event.currentTarget.value, name: null })} />
        )}
        {!handed && NAMED[kind] !== undefined && text("name", NAMED[kind], kind === "sql" ? 420 : 240)}
        <TagsInput size="xs" w={260} maw="100%" label="Only classes" placeholder={chosen.length === 0 ? "all" : ""} data={classes} limit={50} splitChars={[]} value={chosen} onChange={(names) => set({ classes: names.length === 0 ? null : JSON.stringify(names) })} />
        {text("where", "Only takes, as SQL", 260, "actor = 'al'")}
        {kind === "annotations" && !handed && (
          <>
            <NativeSelect size="xs" label="Annotated by" data={["", ...(store?.stages.annotate ?? [])]} value={values.pipeline ?? ""} onChange={(event) => set({ pipeline: event.currentTarget.value })} />
            {text("confidence", "Least confidence", 110, "0 to 1")}
          </>
        )}
      </Part>
      <Part title="Form">
        <NativeSelect size="xs" label="Files" data={facts.forms.map((one) => ({ value: one.name, label: `${one.name}: ${one.meaning}` }))} value={values.form || "csv"} onChange={(event) => set({ form: event.currentTarget.value })} maw={420} />
        {text("rate", "Frames per second", 120, "as they are")}
        {text("margin", "Margin (s)", 90, "0")}
        {text("context", "Surroundings (s)", 110, "0")}
        {text("shortest", "Shortest (s)", 90, "0")}
        {check("joints", "24 joints always")}
        {check("inplace", "Begin at the origin")}
        {check("mirror", "Mirrored twins")}
      </Part>
      <Part title="Split and choice">
        <NativeSelect size="xs" label="Split by" data={[{ value: "", label: "no split" }, ...columns.map((one) => ({ value: one, label: one }))]} value={values.split ?? ""} onChange={(event) => set({ split: event.currentTarget.value })} />
        {values.split !== "" && text("shares", "Shares of train, val, test", 160, "0.8,0.1,0.1")}
        {text("seed", "Seed", 70, "0")}
        {text("perclass", "Most of a class", 110, "all")}
        {text("distinct", "Leave out nearer than (cm)", 170, "none")}
        {check("balance", "As many of each class")}
      </Part>
    </>
  );
}

function Part({ title, children }: { title: string; children: ReactNode }) {
  return (
    <section aria-label={title}>
      <Title order={2} mt={8}>
        {title}
      </Title>
      <Group gap={8} align="end" my={4}>
        {children}
      </Group>
    </section>
  );
}
