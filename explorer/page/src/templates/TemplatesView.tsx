// The list of templates, and the one that is chosen beside it.

import { Loader, NativeSelect, SegmentedControl, Text, TextInput } from "@mantine/core";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { memo, useRef } from "react";
import { Link } from "wouter";

import { get } from "../api/client";
import type { StoreFacts } from "../api/types";
import { useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useShortcuts } from "../app/shortcuts";
import { Picture } from "./Picture";
import { TemplateView } from "./TemplateView";
import type { ListRow, TemplateList } from "./types";

const NO_EDITS = { weights: null, from: null, to: null, tau: null, other: null, other_stage: null, clip: null };

export function TemplatesView({ store }: { store: StoreFacts }) {
  const [stage] = useParameter("stage");
  const [kind] = useParameter("kind");
  const [chosen] = useParameter("template");
  const [filter, setFilter] = useParameter("filter");
  const set = useParameters();
  const typed = useRef<HTMLInputElement>(null);
  const asked = new URLSearchParams({ ...(stage === null ? {} : { stage }), ...(kind === null ? {} : { kind }) });
  const found = useQuery({
    queryKey: ["version", "templates", asked.toString()],
    queryFn: ({ signal }) => get<TemplateList>(`/api/templates?${asked.toString()}`, signal),
    placeholderData: keepPreviousData,
  });
  useSame(chosen === null ? found.data : undefined);
  const rows = (found.data?.templates ?? []).filter((one) => fits(one, filter ?? ""));
  const step = (by: number) => {
    const at = rows.findIndex((one) => one.name === chosen);
    const next = rows[at < 0 ? 0 : Math.max(0, Math.min(rows.length - 1, at + by))];
    if (next !== undefined) set({ ...NO_EDITS, template: next.name }, true);
  };
  useShortcuts("Templates", [
    { keys: "j", what: "Next template", run: () => step(1) },
    { keys: "k", what: "Template before", run: () => step(-1) },
    { keys: "/", what: "Find a template by its name", run: () => typed.current?.focus() },
  ]);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  const list = found.data;
  if (list.stages.length === 0) return <NoTemplates store={store} />;
  return (
    <>
      <div className="templates-tools">
        {list.stages.length > 1 && (
          <NativeSelect
            size="xs"
            aria-label="Stage that learned the templates"
            data={list.stages}
            value={list.stage}
            onChange={(event) => set({ ...NO_EDITS, stage: event.currentTarget.value, kind: null }, true)}
          />
        )}
        {(list.kinds?.length ?? 0) > 1 && (
          <SegmentedControl
            size="xs"
            aria-label="Kind of templates"
            data={list.kinds ?? []}
            value={list.kind}
            onChange={(value) => set({ ...NO_EDITS, kind: value }, true)}
          />
        )}
        <TextInput
          ref={typed}
          size="xs"
          aria-label="Templates whose names contain"
          placeholder="find by name"
          value={filter ?? ""}
          onChange={(event) => setFilter(event.currentTarget.value)}
        />
        <Text size="sm" className="muted" role="status">
          {rows.length === list.templates.length ? `${rows.length} templates` : `${rows.length} of ${list.templates.length} templates`} of{" "}
          {list.stage}
          {list.annotate == null ? ", which no stage annotates with" : `, with which ${list.annotate} annotates (${list.method ?? ""}, δ = ${list.delta ?? ""})`}
        </Text>
      </div>
      {list.remarks.map((one) => (
        <Text key={one} size="sm" className="templates-remark">
          {one}
        </Text>
      ))}
      <div className="templates-body" data-chosen={chosen !== null}>
        <nav className="templates-list" aria-label="Templates">
          <ul>
            {rows.map((one) => (
              <Card key={one.name} row={one} current={one.name === chosen} href={addressOf(one.name, stage, kind, filter)} />
            ))}
          </ul>
          {rows.length === 0 && <Text size="sm">No template has such a name.</Text>}
        </nav>
        {chosen !== null && list.stage !== undefined && list.kind !== undefined && (
          <TemplateView
            key={`${list.stage} ${list.kind} ${chosen}`}
            store={store}
            stage={list.stage}
            kind={list.kind}
            name={chosen}
            list={list}
            onClose={() => set({ ...NO_EDITS, template: null }, true)}
          />
        )}
      </div>
    </>
  );
}

function fits(one: ListRow, filter: string): boolean {
  const text = filter.trim().toLowerCase();
  return one.name.toLowerCase().includes(text) || one.class.toLowerCase().includes(text);
}

function addressOf(template: string, stage: string | null, kind: string | null, filter: string | null): string {
  const parts = { template, ...(stage === null ? {} : { stage }), ...(kind === null ? {} : { kind }), ...(filter === null ? {} : { filter }) };
  return `/templates?${new URLSearchParams(parts).toString()}`;
}

const Card = memo(function Card({ row, current, href }: { row: ListRow; current: boolean; href: string }) {
  return (
    <li>
      <Link href={href} className="template-card" aria-current={current ? "true" : undefined} title={row.remarks.join("\n") || undefined}>
        <Picture picture={row.picture} columns={row.columns} />
        <b>{row.name}</b>
        <span className="muted">
          {row.class === row.name ? "" : `${row.class} · `}
          {row.seconds.toFixed(2)} s · {row.clips} {row.clips === 1 ? "clip" : "clips"}{row.tau !== null && ` · τ ${row.tau.toFixed(3)}`}
        </span>
        {row.remarks.length > 0 && <span className="templates-remark">{row.remarks.length === 1 ? "1 remark" : `${row.remarks.length} remarks`}</span>}
      </Link>
    </li>
  );
});

function NoTemplates({ store }: { store: StoreFacts }) {
  return (
    <div>
      <Text size="sm">This store has no learned template yet. They are learned</Text>
      <ul className="templates-ways">
        <li>
          from labels: label some segments on the page <Link href="/label">Label</Link>, then choose Learn;
        </li>
        <li>
          by a pipeline, such as annotate, from the clips of classes: page <Link href="/runs?view=start">Runs</Link>, or{" "}
          <code>kinedex run annotate --store {store.path}</code>.
        </li>
      </ul>
    </div>
  );
}
