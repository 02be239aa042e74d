// Pipelines with their settings, the plan with its reasons, and the start of a run.

import { Alert, Button, Code, Group, Table, Text, Textarea, TextInput, Title } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";

import { get, post } from "../api/client";
import { useStore } from "../api/queries";
import type { Same } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { Titles } from "../app/Titles";
import { duration, moment, parametersOf } from "./text";
import type { Pipeline, Plan, Setting } from "./types";

export function Start({ readOnly }: { readOnly: boolean }) {
  const version = useStore().data?.version;
  const found = useQuery({
    queryKey: ["version", "pipelines", version],
    queryFn: ({ signal }) => get<Same & { pipelines: Pipeline[] }>("/api/pipelines", signal),
    placeholderData: (old) => old,
  });
  const [chosen, choose] = useParameter("pipeline");
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  const pipelines = found.data?.pipelines ?? [];
  const named = pipelines.find((one) => one.id === chosen);
  const pipeline = chosen === null ? pipelines[0] : named;
  if (found.data === undefined) return null;
  return (
    <div className="runs-pipelines">
      <nav aria-label="Pipelines">
        <ul className="runs-list">
          {pipelines.map((one) => (
            <li key={one.id}>
              <button type="button" aria-current={one.id === pipeline?.id} onClick={() => choose(one.id, true)} title={one.path}>
                {one.name}
                {!one.shipped && <span className="muted"> · run in this store</span>}
              </button>
            </li>
          ))}
        </ul>
      </nav>
      {pipeline === undefined ? (
        <Text size="sm">{chosen === null ? "There is no pipeline." : `No pipeline has the name “${chosen}”: choose one beside.`}</Text>
      ) : (
        <OnePipeline key={pipeline.id} pipeline={pipeline} readOnly={readOnly} />
      )}
    </div>
  );
}

function OnePipeline({ pipeline, readOnly }: { pipeline: Pipeline; readOnly: boolean }) {
  const [values, setValues] = useState<Record<string, string>>({});
  const [more, setMore] = useState("");
  const [plan, setPlan] = useState<Plan | null>(null);
  const [fault, setFault] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  useSame(plan ?? undefined);
  const parameters = parametersOf(more);
  const ask = async (run: boolean) => {
    const typed = Object.fromEntries(Object.entries(values).filter(([, value]) => value !== ""));
    const body = { pipeline: pipeline.id, settings: { ...typed, ...parameters.values } };
    setFault(null);
    setBusy(true);
    try {
      const next = await post<Plan>("/api/runs/plan", body);
      setPlan(next);
      if (run && next.problem === null) await post("/api/runs", body);
    } catch (found) {
      setFault(found);
    } finally {
      setBusy(false);
    }
  };
  const change = (name: string, value: string) => {
    setValues({ ...values, [name]: value });
    setPlan(null); // it was that of other settings
  };
  const problem = plan?.problem ?? null;
  const known = pipeline.settings.some((one) => one.name === problem?.setting);
  const wrongMore = parameters.wrong !== null ? `expected NAME=VALUE, not ${parameters.wrong}` : problem?.setting != null && problem.setting in parameters.values ? problem.message : null;
  return (
    <section aria-label={`Pipeline ${pipeline.name}`}>
      <Title order={2}>{pipeline.name}</Title>
      <Text size="sm">{pipeline.description}</Text>
      <Text size="xs" className="muted" style={{ overflowWrap: "anywhere" }}>{pipeline.path}</Text>
      {pipeline.problem !== null && <Fault fault={pipeline.problem} />}
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void ask(false);
        }}
      >
        <div className="runs-settings">
          {pipeline.settings.map((one) => (
            <TextInput
              key={one.name}
              size="xs"
              label={one.name}
              description={about(one)}
              placeholder={one.default ?? ""}
              value={values[one.name] ?? ""}
              error={problem?.setting === one.name ? problem.message : null}
              onChange={(event) => change(one.name, event.currentTarget.value)}
            />
          ))}
        </div>
        <Textarea
          size="xs"
          maw={540}
          autosize
          minRows={2}
          label="Parameters of stages"
          description="One a line, as annotate.tau=0.06"
          value={more}
          error={wrongMore}
          onChange={(event) => {
            setMore(event.currentTarget.value);
            setPlan(null);
          }}
        />
        <Group gap={8} my={8}>
          <Button size="compact-sm" variant="default" type="submit" loading={busy} disabled={parameters.wrong !== null}>
            Show the plan
          </Button>
          {!readOnly && (
            <Button size="compact-sm" onClick={() => void ask(true)} disabled={busy || parameters.wrong !== null}>
              Run
            </Button>
          )}
          {readOnly && <Text size="sm">This explorer only reads: nothing is run.</Text>}
        </Group>
      </form>
      {fault !== null && <Fault fault={fault} />}
      {problem !== null && !known && wrongMore === null && (
        <Alert color="red" variant="light" role="alert" title="It would not run">
          <Text size="sm" style={{ overflowWrap: "anywhere" }}>{problem.message}</Text>
        </Alert>
      )}
      {plan !== null && problem === null && <PlanTable plan={plan} />}
    </section>
  );
}

function about(setting: Setting): string {
  const parts = [setting.default === null ? "no default" : `default ${setting.default === "" ? "empty" : setting.default}`];
  if (setting.last !== null) parts.push(`last run ${setting.last}`);
  return parts.join(" · ");
}

function PlanTable({ plan }: { plan: Plan }) {
  const running = plan.stages.filter((one) => one.reason !== null).length;
  return (
    <section aria-label="Plan">
      <Text size="sm" role="status" data-testid="plan">
        {running === 0 ? "Every stage is up to date." : `${running} of ${plan.stages.length} stages run.`}
      </Text>
      <div className="runs-table" tabIndex={0} role="region" aria-label="Stages of the plan">
        <Table verticalSpacing={3} maw={900}>
          <Titles of={["Stage", "Inputs", "Runs because", "Last run"]} />
          <Table.Tbody>
            {plan.stages.map((one) => (
              <Table.Tr key={one.stage}>
                <Table.Td>
                  <Code>{one.stage}</Code>
                </Table.Td>
                <Table.Td>{one.inputs.join(", ")}</Table.Td>
                <Table.Td>{one.reason ?? (one.what === "" ? "does not run: nothing to do" : `does not run: unchanged, ${one.what}`)}</Table.Td>
                <Table.Td>{one.finished === null ? "never" : `${moment(one.finished)} (${duration(one.seconds ?? 0)})`}</Table.Td>
              </Table.Tr>
            ))}
          </Table.Tbody>
        </Table>
      </div>
    </section>
  );
}
