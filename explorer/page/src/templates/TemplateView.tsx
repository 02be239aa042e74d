// One template: its matrix with the pose at each column, its edits with their effect, its clips, and how it differs from
// another one.

import { Button, CloseButton, Group, Loader, Text, Title } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useMemo, useState } from "react";
import { Link } from "wouter";

import { get, postLines } from "../api/client";
import type { Step } from "../api/lines";
import { shownSeconds } from "../api/seconds";
import type { StoreFacts } from "../api/types";
import { takeAddress, useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useShortcuts } from "../app/shortcuts";
import { SmallFigure } from "../motion/SmallFigure";
import { Clips } from "./Clips";
import { DifferenceView } from "./DifferenceView";
import { askAddress, isEdited, MAX_CLIPS, useEdits } from "./edits";
import { EffectDetails, EffectView } from "./EffectView";
import { Matrix, type Place } from "./Matrix";
import type { Clip, Effect, TemplateFacts, TemplateList } from "./types";

const WAIT_MS = 150;

export interface TemplateViewProps {
  store: StoreFacts;
  stage: string;
  kind: string;
  name: string;
  list: TemplateList;
  onClose: () => void;
}

export function TemplateView({ store, stage, kind, name, list, onClose }: TemplateViewProps) {
  const asked = new URLSearchParams({ stage, kind, template: name }).toString();
  const found = useQuery({
    queryKey: ["version", "template", asked],
    queryFn: ({ signal }) => get<TemplateFacts>(`/api/templates/one?${asked}`, signal),
  });
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  return <Opened store={store} facts={found.data} list={list} onClose={onClose} />;
}

interface OpenedProps {
  store: StoreFacts;
  facts: TemplateFacts;
  list: TemplateList;
  onClose: () => void;
}

function Opened({ store, facts, list, onClose }: OpenedProps) {
  const { edits, setWeight, setColumns, setTau, reset } = useEdits(facts.columns);
  const [truth, setTruth] = useParameter("truth");
  const [among, setAmong] = useParameter("among");
  const [place, setPlace] = useState<Place | null>(null);
  const [shownClip, setShownClip] = useParameter("clip");
  const [judge, setJudge] = useParameter("judge");
  const compete = among !== "class";
  const body = JSON.stringify({
    stage: facts.stage,
    kind: facts.kind,
    template: facts.name,
    weights: edits.weights,
    first: edits.first,
    stop: edits.stop,
    compete,
    everything: judge === "all",
    ...(edits.tau === null ? {} : { tau: edits.tau }),
    ...(truth === "labels" || truth === "evaluation" ? { truth } : {}),
  });
  const [step, setStep] = useState<Step>({ done: 0, total: 0 });
  const [settled] = useDebouncedValue(body, WAIT_MS);
  const effect = useQuery({
    // what is held out depends on labels as well as on the version
    queryKey: ["labels", "template-effect", store.version, settled],
    queryFn: ({ signal }) => {
      setStep({ done: 0, total: 0 });
      return postLines<Effect>("/api/templates/effect", JSON.parse(settled), setStep, signal);
    },
    placeholderData: keepPreviousData,
    retry: false,
  });
  useSame(effect.data ?? facts);
  const edited = isEdited(edits, facts.columns);
  const old = body !== settled || effect.isPlaceholderData || effect.isFetching;
  useShortcuts("Template", [
    { keys: "0", what: "Undo all edits of the template", run: reset },
    { keys: "Escape", what: "Close the template", run: onClose },
  ]);
  const poses = facts.clips.find((one) => one.name === shownClip && one.frames !== null) ?? facts.clips[facts.poses ?? -1];
  const examples = useMemo(() => facts.clips.slice(-MAX_CLIPS), [facts]);
  return (
    <article className="template" aria-label={facts.name}>
      <Group justify="space-between" wrap="nowrap" align="flex-start">
        <div>
          <Title order={2}>{facts.name}</Title>
          <Text size="sm" className="muted">
            {facts.heading}
            {facts.class === facts.name ? "" : `; of the class ${facts.class}`}
          </Text>
        </div>
        <Group gap={6} wrap="nowrap">
          {examples.length > 0 && (
            <Button size="compact-sm" variant="default" component={Link} href={askAddress(examples)}>
              Search by {examples.length === facts.clips.length ? "its clips" : `${examples.length} of its clips`}
            </Button>
          )}
          <CloseButton aria-label="Close the template" onClick={onClose} />
        </Group>
      </Group>
      {facts.remarks.map((one) => (
        <Text key={one} size="sm" className="templates-remark">
          {one}
        </Text>
      ))}
      <section className="effect" aria-label="Edits and their effect">
        <EffectView
          facts={facts}
          edits={edits}
          edited={edited}
          body={body}
          answer={effect.data}
          fault={effect.error}
          old={old}
          step={step}
          compete={compete}
          onTau={setTau}
          onTruth={setTruth}
          onCompete={(next) => setAmong(next ? null : "class")}
          onEverything={(next) => setJudge(next ? "all" : null)}
          onReset={reset}
        />
        <div className="template-parts">
          <Matrix
            facts={facts}
            features={store.features}
            edits={edits}
            at={place}
            onAt={setPlace}
            onWeight={setWeight}
            onColumns={setColumns}
          />
          <PosePanel store={store} facts={facts} clip={poses} place={place} />
        </div>
        {effect.data !== undefined && effect.error === null && (
          <EffectDetails answer={effect.data} old={old} edited={edited} compete={compete} rateHz={store.rate_hz} />
        )}
      </section>
      <DifferenceView store={store} facts={facts} list={list} />
      <Clips facts={facts} rateHz={store.rate_hz} shown={poses?.name ?? null} onShow={(clip) => setShownClip(clip.name)} />
    </article>
  );
}

interface PosePanelProps {
  store: StoreFacts;
  facts: TemplateFacts;
  clip: Clip | undefined;
  place: Place | null;
}

/** The pose of a clip at the column that is pointed at, and what lies there. */
function PosePanel({ store, facts, clip, place }: PosePanelProps) {
  const column = place?.column ?? Math.floor(facts.columns / 2);
  const feature = store.features.find((one) => one.bit === place?.bit);
  const share = feature === undefined ? undefined : facts.values[feature.bit]?.[column];
  const frame = clip?.frames?.[column];
  return (
    <aside className="template-pose" aria-label="Pose at the column">
      {clip === undefined || frame === undefined ? (
        <Text size="sm" className="muted">
          The store has none of its clips, so there is no pose to show.
        </Text>
      ) : (
        <SmallFigure
          item={clip}
          at={(frame - clip.start + 0.5) / (clip.stop - clip.start)}
          width={170}
          height={200}
          label={`The pose of ${clip.take} at column ${column + 1}`}
        />
      )}
      <Text size="sm" role="status">
        column {column + 1} of {facts.columns}, {shownSeconds(column, store.rate_hz)} s
      </Text>
      {feature === undefined || share === undefined ? (
        <Text size="sm" className="muted">
          Point at the matrix, or use the arrow keys in it.
        </Text>
      ) : (
        <Text size="sm">
          <b>{feature.name}</b> ({feature.description}): {saidOf(share, facts)}
        </Text>
      )}
      {clip !== undefined && (
        <Text size="xs" className="muted">
          Pose of <Link href={takeAddress(clip.take, clip.start, clip.stop)}>{clip.name}</Link>, which the template fits{" "}
          {clip === facts.clips[facts.poses ?? -1] ? "best" : "too"}
          {frame === undefined ? "" : `, frame ${frame}`}
        </Text>
      )}
    </aside>
  );
}

function saidOf(share: number, facts: TemplateFacts): string {
  const percent = `${(100 * share).toFixed(0)} %`;
  if (facts.kind === "hard") return share === 0.5 ? "varies among the clips" : share === 1 ? "on in all clips" : "off in all clips";
  const counts = share <= facts.delta || share >= 1 - facts.delta ? "" : ", so it counts nothing here";
  return `on in ${percent} of the clips${counts}`;
}
