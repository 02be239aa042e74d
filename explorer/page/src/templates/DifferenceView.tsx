// What distinguishes two templates: one minus the other along the warping path, and the features that differ most.

import { Button, Loader, NativeSelect, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useRef, useState } from "react";

import { get } from "../api/client";
import type { StoreFacts } from "../api/types";
import { useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { onTheme } from "../motion/colours";
import { drawMatrix } from "./draw";
import type { Difference, TemplateFacts, TemplateList } from "./types";

const ROW = 11;
const FIRST = 8;

export function DifferenceView({ store, facts, list }: { store: StoreFacts; facts: TemplateFacts; list: TemplateList }) {
  const [other] = useParameter("other");
  const [otherStage] = useParameter("other_stage");
  const set = useParameters();
  const stages = list.stages.filter((one) => one !== facts.stage);
  const options = [
    { value: "", label: "choose another template" },
    ...list.templates.filter((one) => one.name !== facts.name).map((one) => ({ value: one.name, label: one.name })),
    ...stages.map((stage) => ({ value: `${stage}\n${facts.name}`, label: `${facts.name} of ${stage}` })),
  ];
  const asked = new URLSearchParams({
    stage: facts.stage,
    kind: facts.kind,
    template: facts.name,
    other: other ?? "",
    ...(otherStage === null ? {} : { other_stage: otherStage }),
  }).toString();
  const found = useQuery({
    queryKey: ["version", "template-difference", asked],
    queryFn: ({ signal }) => get<Difference>(`/api/templates/difference?${asked}`, signal),
    enabled: other !== null,
  });
  return (
    <section aria-label="What distinguishes two">
      <h3>What distinguishes it from another</h3>
      <NativeSelect
        size="xs"
        aria-label="The other template"
        maw={340}
        data={options}
        value={other === null ? "" : otherStage === null ? other : `${otherStage}\n${other}`}
        onChange={(event) => {
          const [first = "", second] = event.currentTarget.value.split("\n");
          set({ other: second ?? first, other_stage: second === undefined ? null : first }, true);
        }}
      />
      {found.isError && <Fault fault={found.error} retry={() => void found.refetch()} />}
      {other !== null && found.data === undefined && !found.isError && <Loader m="xs" size="sm" aria-label="Comparing" />}
      {other !== null && found.data !== undefined && <Compared store={store} found={found.data} />}
    </section>
  );
}

function Compared({ store, found }: { store: StoreFacts; found: Difference }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [all, setAll] = useState(false);
  const order = useMemo(() => found.features.map((one) => one.bit), [found]);
  const aligned = found.columns.length;
  useEffect(() => {
    const shown = canvas.current;
    if (shown === null) return;
    const draw = () => drawMatrix(shown, found.values, { order, row: ROW, column: Math.max(3, Math.min(9, 420 / aligned)), signed: true });
    draw();
    return onTheme(draw);
  }, [found, order, aligned]);
  const features = all ? found.features : found.features.slice(0, FIRST);
  const column = Math.max(3, Math.min(9, 420 / aligned));
  return (
    <div className="difference">
      <figure>
        <canvas
          ref={canvas}
          role="img"
          aria-label={`${found.first} minus ${found.second} along the warping path: ${store.features.length} features, ${aligned} aligned columns`}
          style={{ width: aligned * column, height: ROW * order.length }}
        />
        <figcaption className="muted">
          <span className="difference-first">on in {found.first} only</span>, <span className="difference-second">on in {found.second} only</span>; the
          features that differ most first, {aligned} aligned columns
        </figcaption>
      </figure>
      <div>
        <Text size="sm">{found.summary}.</Text>
        <ol className="difference-list">
          {features.map((one) => (
            <li key={one.bit}>
              <meter min={0} max={1} value={one.difference} aria-label={`Mean difference of ${one.name}`} /> {one.difference.toFixed(2)} <b>{one.name}</b>{" "}
              <span className="muted">{one.words}</span>
            </li>
          ))}
        </ol>
        {!all && (
          <Button size="compact-xs" variant="default" onClick={() => setAll(true)}>
            Show all {found.features.length} features
          </Button>
        )}
      </div>
    </div>
  );
}
