import "./templates.css";

import { Loader, SegmentedControl, Title } from "@mantine/core";

import { useStore } from "../api/queries";
import { useParameters, useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { QueriesView } from "./QueriesView";
import { TemplatesView } from "./TemplatesView";

/** Templates and queries that the store has learned. */
export default function TemplatesPage() {
  const [view] = useParameter("view");
  const set = useParameters();
  const store = useStore();
  if (store.isError) return <Fault fault={store.error} retry={() => void store.refetch()} />;
  if (store.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  const shown = view === "queries" ? "queries" : "templates";
  return (
    <div className="page templates">
      <header className="templates-head">
        <Title order={1}>Templates</Title>
        <SegmentedControl
          size="xs"
          aria-label="What is shown"
          value={shown}
          onChange={(value) => set({ view: value === "queries" ? value : null, stage: null, template: null, query: null }, true)}
          data={[
            { value: "templates", label: "Templates" },
            { value: "queries", label: "Keyframe queries" },
          ]}
        />
      </header>
      {shown === "templates" ? <TemplatesView store={store.data} /> : <QueriesView store={store.data} />}
    </div>
  );
}
