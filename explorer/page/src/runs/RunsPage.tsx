import "./runs.css";

import { Tabs, Title } from "@mantine/core";

import { useStore } from "../api/queries";
import { useParameter } from "../app/address";
import { History } from "./History";
import { Jobs } from "./Jobs";
import { Methods } from "./Methods";
import { Start } from "./Start";

/** Runs: pipelines with their plan, jobs in progress, the history, and the methods compared. */
export default function RunsPage() {
  const store = useStore().data;
  const [view, setView] = useParameter("view");
  const readOnly = store?.read_only !== false;
  return (
    <div className="page runs-page">
      <Title order={1}>Runs</Title>
      <Jobs readOnly={readOnly} />
      <Tabs value={view === "start" || view === "methods" ? view : "history"} onChange={(value) => setView(value === "history" ? null : value, true)} keepMounted={false}>
        <Tabs.List mb={8}>
          <Tabs.Tab value="history">History</Tabs.Tab>
          <Tabs.Tab value="start">Pipelines</Tabs.Tab>
          <Tabs.Tab value="methods">Methods compared</Tabs.Tab>
        </Tabs.List>
        <Tabs.Panel value="history">
          <History />
        </Tabs.Panel>
        <Tabs.Panel value="start">
          <Start readOnly={readOnly} />
        </Tabs.Panel>
        <Tabs.Panel value="methods">
          <Methods />
        </Tabs.Panel>
      </Tabs>
    </div>
  );
}
