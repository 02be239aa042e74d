import "./archive.css";

import { Loader, Tabs, Title } from "@mantine/core";
import { Suspense, useMemo } from "react";

import { useStore } from "../api/queries";
import { useParameter } from "../app/address";
import { useSame } from "../app/same";
import { FilterBar } from "./FilterBar";
import { GroupBy } from "./GroupBy";
import { sortsOf, useGroupColumn } from "./groups";
import { useTakes } from "./questions";
import { useColumns, useSelection, useSort } from "./selection";
import { ColumnMenu, TakesView } from "./TakesView";
import { counted, hours } from "./text";
import { VIEWS } from "./views";

/** All takes of the archive: filters, table, totals, and what is to be looked at. */
export default function ArchivePage() {
  const [key, setKey] = useParameter("view");
  const view = VIEWS.find((one) => one.key === key);
  return (
    <div className="page archive">
      <Title order={1} className="visually-hidden">
        Archive
      </Title>
      <Tabs value={view?.key ?? "takes"} onChange={(next) => setKey(next === "takes" ? null : next, true)}>
        <Tabs.List>
          <Tabs.Tab value="takes">Takes</Tabs.Tab>
          {VIEWS.map((one) => (
            <Tabs.Tab key={one.key} value={one.key}>
              {one.title}
            </Tabs.Tab>
          ))}
        </Tabs.List>
      </Tabs>
      <Content key={view?.key} view={view} />
    </div>
  );
}

function Content({ view }: { view: (typeof VIEWS)[number] | undefined }) {
  const state = useSelection();
  if (view === undefined) return <Takes state={state} />;
  return (
    <>
      {view.filtered && <FilterBar state={state} fault={null} />}
      <div className="archive-view">
        <Suspense fallback={<Loader size="sm" aria-label="Loading" />}>
          <view.view selection={state.selection} />
        </Suspense>
      </div>
    </>
  );
}

function Takes({ state }: { state: ReturnType<typeof useSelection> }) {
  const store = useStore();
  const [sort] = useSort();
  const [columns] = useColumns(store.data);
  const [by, setBy] = useGroupColumn(null);
  const sorts = useMemo(() => sortsOf(by, sort), [by, sort]);
  const takes = useTakes(state.selection, sorts, columns);
  const wrong = takes.error !== null && state.where !== null;
  useSame(takes.head);
  return (
    <>
      <FilterBar state={state} fault={wrong ? (takes.error?.message ?? null) : null} />
      <div className="amount">
        <span role="status" aria-live="polite">
          {takes.head !== undefined && !wrong && (
            <>
              <strong>{counted(takes.head.total, "take")}</strong>, {hours(takes.head.hours)}
              {store.data !== undefined && takes.head.total < store.data.takes && (
                <span className="muted"> of {counted(store.data.takes, "take")}</span>
              )}
            </>
          )}
        </span>
        <span className="spring" />
        <GroupBy by={by} onChange={setBy} />
        <ColumnMenu />
      </div>
      <div className="archive-view">
        <TakesView state={state} takes={takes} columns={columns} by={by} />
      </div>
    </>
  );
}
