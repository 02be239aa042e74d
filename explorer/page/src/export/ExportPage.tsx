// The page Export: what would be written, with sizes and splits, then written.

import { Loader, Title } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { useQuery } from "@tanstack/react-query";

import { get, post } from "../api/client";
import { useStore } from "../api/queries";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { PlanTable } from "./PlanTable";
import { bodyOf, useRequest } from "./request";
import { Settings } from "./Settings";
import type { Facts, Plan } from "./types";
import { Writing } from "./Writing";

export default function ExportPage() {
  const [values, set] = useRequest();
  const store = useStore().data;
  const facts = useQuery({ queryKey: ["export"], queryFn: ({ signal }) => get<Facts>("/api/export", signal), staleTime: 0 });
  const current = JSON.stringify(bodyOf(values));
  const [asked] = useDebouncedValue(current, 400);
  const plan = useQuery({
    queryKey: ["labels", "export", store?.version, asked],
    queryFn: ({ signal }) => post<Plan>("/api/export/plan", JSON.parse(asked), signal),
    retry: false,
  });
  useSame(plan.data);
  if (facts.isError) return <div className="page"><Fault fault={facts.error} retry={() => void facts.refetch()} /></div>;
  if (facts.data === undefined) return <div className="page"><Loader size="sm" aria-label="Loading" /></div>;
  const isCurrent = asked === current && plan.data !== undefined;
  return (
    <div className="page" style={{ overflow: "auto" }}>
      <Title order={1}>Export</Title>
      <Settings values={values} set={set} facts={facts.data} />
      <Title order={2} mt={8}>
        What would be written
      </Title>
      {plan.isError && <Fault fault={plan.error} />}
      {plan.isFetching && <Loader size="xs" aria-label="Planning" />}
      {plan.data !== undefined && !plan.isError && <PlanTable plan={plan.data} />}
      <Writing folder={values.folder ?? ""} setFolder={(folder) => set({ folder })} body={JSON.parse(current) as Record<string, unknown>} planned={isCurrent ? plan.data.state : null} last={facts.data.job} readOnly={store?.read_only === true} />
    </div>
  );
}
