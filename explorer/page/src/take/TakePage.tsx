import "./take.css";

import { Badge, Group, Loader, MultiSelect, Switch, Text, Title } from "@mantine/core";
import { useCallback, useMemo } from "react";
import { Link, useLocation } from "wouter";

import { useStore } from "../api/queries";
import type { StoreFacts } from "../api/types";
import { takeAddress, takeName, useJsonParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { makeBody } from "../motion/body";
import type { Actor } from "../motion/actors";
import { AlikePanel } from "./Alike";
import { useBeside } from "./beside";
import { ChooseTake } from "./ChooseTake";
import { HitPanel } from "./HitPanel";
import { useKeys } from "./keys";
import { LanesView } from "./LanesView";
import { useCurves, useDocument, useHit, useImage, useLanes, useMotion, useMotions, useTemplates, useWords } from "./load";
import { FactsPanel, Panel, PosePanel, SelectionPanel } from "./panels";
import { Player } from "./Player";
import type { Row } from "./rows";
import { RunsTable } from "./RunsTable";
import type { Session } from "./session";
import { segmentStarts, useClassColours, useClosed, usePicked, useSession, useTemplateNames } from "./state";
import type { ErrorLimb, FittedHit, Lane, Segment, TakeDocument, TakeTemplates } from "./types";

/** One take: its motion, and under it lanes of all that is known about it. */
export default function TakePage() {
  const name = useTakeName();
  const store = useStore();
  const document = useDocument(name);
  if (name === null) return <ChooseTake />;
  const fault = document.error ?? store.error;
  if (fault !== null) return <Fault fault={fault} retry={() => void document.refetch()} />;
  if (document.data === undefined || store.data === undefined)
    return <Loader m="md" size="sm" aria-label="The take is being opened" />;
  const { take_id, version } = document.data;
  return <OpenTake key={`${take_id}/${version}`} document={document.data} store={store.data} />;
}

/** Return the name of the take in the address, decoded once: names may hold slashes and percent signs. */
function useTakeName(): string | null {
  const [location] = useLocation();
  return useMemo(() => takeName(window.location.pathname), [location]);
}

const NO_LANES: readonly Lane[] = [];
const NO_LIMBS: readonly ErrorLimb[] = [];
const sameFrame = (_actor: number, frame: number) => frame;

function OpenTake({ document, store }: { document: TakeDocument; store: StoreFacts }) {
  const { take_id: id, version, name } = document;
  const session = useSession(document);
  const body = useMemo(() => makeBody(store.joints, store.parents), [store]);
  const { motion, fault: motionFault } = useMotion(id, version, session);
  const { words, fault: wordsFault } = useWords(id, version, store.features.length);
  const lanes = useLanes(id, version, session);
  const templates = useTemplates(id, version, session);
  const [closed, toggle] = useClosed();
  const [names, setNames] = useTemplateNames(templates.data);
  const { curves, faults } = useCurves(id, version, names, templates.data, lanes.data?.limbs ?? NO_LIMBS);
  const unknown = useMemo(() => new Set(document.unknown), [document.unknown]);
  const every = lanes.data?.lanes ?? NO_LANES;
  const colourOf = useClassColours(every);
  const [picked, pick] = usePicked();
  const hit = useHit(id, version, picked?.name ?? null, picked?.frame ?? 0, templates.data);
  const image = useImage(picked?.name ?? null, version, templates.data);
  const alone = useMemo<Actor>(() => ({ motion }), [motion]);
  const beside = useBeside(session, document, alone, hit.data);
  const persons = usePersons(document, session);
  const actors = useMemo(() => beside.actors ?? [alone, ...persons.actors], [beside.actors, alone, persons.actors]);
  const starts = useMemo(() => segmentStarts(every), [every]);
  const set = useParameters();
  useSame(document);
  useKeys(session, starts);
  const onPick = useCallback(
    (row: Row, segment: Segment | null, frame: number) => {
      if (row.kind === "curve" && row.unit === "") pick(row.name, frame);
      else if (row.kind === "segments" && row.lane.group === "annotations" && segment?.subclass !== undefined)
        pick(segment.subclass, Math.floor((segment.start + segment.stop) / 2));
    },
    [pick],
  );
  const onBeside = (found: FittedHit) => {
    if (found.example === null) return;
    session.select([found.start, found.stop]);
    session.seek(found.start);
    set({ beside: found.example.take, step: "hit", bfrom: String(found.example.start), bto: String(found.example.stop) });
  };
  const fault = motionFault ?? wordsFault ?? lanes.error ?? templates.error ?? faults[0];
  return (
    <div className="page take">
      <Header document={document} />
      {fault !== null && fault !== undefined && <Fault fault={fault} />}
      <div className="take-upper">
        <Player
          session={session}
          body={body}
          actors={actors}
          frameOf={beside.actors === null ? sameFrame : beside.frameOf}
          label={`The motion of ${name} as a figure; the features of the pose are listed beside it.`}
        />
        <aside className="take-side" aria-label="About the selection, the pose and the take">
          <SelectionPanel session={session} name={name} />
          {picked !== null && (
            <HitPanel
              session={session}
              name={picked.name}
              hit={hit.data}
              image={image.data}
              fault={hit.error ?? image.error}
              features={store.features}
              onBeside={onBeside}
              onClose={() => pick(null)}
            />
          )}
          <AlikePanel session={session} id={id} name={name} />
          {beside.panel}
          {persons.panel}
          <PosePanel session={session} words={words} features={store.features} unknown={unknown} name={name} />
          <FactsPanel document={document} suspect={lanes.data?.suspect ?? []} />
        </aside>
      </div>
      <section aria-label="Lanes" className="take-lanes">
        <LaneTools templates={templates.data} names={names} setNames={setNames} />
        <LanesView
          session={session}
          words={words}
          lanes={every}
          curves={curves}
          features={store.features}
          unknown={unknown}
          closed={closed}
          colourOf={colourOf}
          onGroup={toggle}
          onPick={onPick}
        />
        <RunsTable session={session} lanes={every} features={store.features} words={words} />
      </section>
    </div>
  );
}

function LaneTools({
  templates,
  names,
  setNames,
}: {
  templates: TakeTemplates | undefined;
  names: readonly string[];
  setNames: (names: string[]) => void;
}) {
  const offered = (templates?.templates ?? []).filter((one) => one.applied && one.kind === "soft");
  const none = templates?.templates.length === 0;
  return (
    <Group gap={10} className="take-tools">
      <Title order={2}>Lanes</Title>
      <MultiSelect
        size="xs"
        aria-label="Templates whose distance curves are shown"
        placeholder={names.length > 0 ? "" : none ? "No templates in this store yet" : "Distance curves of templates"}
        disabled={none}
        searchable
        maxValues={8}
        data={[...new Set(offered.map((one) => one.name))]}
        value={[...names]}
        onChange={setNames}
        className="take-templates"
      />
      <Text size="xs" className="muted take-hint">
        wheel: zoom · Shift and wheel: pan · drag: select · double click: select a run · ? lists the keys
      </Text>
    </Group>
  );
}

function Header({ document }: { document: TakeDocument }) {
  const { name, columns, warnings } = document;
  return (
    <Group gap={8} className="take-header">
      <Title order={1}>{name}</Title>
      {typeof columns.class === "string" && <Badge variant="light" tt="none">{columns.class}</Badge>}
      {typeof columns.actor === "string" && <Badge variant="default" tt="none">{columns.actor}</Badge>}
      {warnings.length > 0 && <Badge color="orange" variant="light" tt="none">{warnings.length === 1 ? "1 warning" : `${warnings.length} warnings`}</Badge>}
    </Group>
  );
}

/** Most other persons that are shown; the motion of each is loaded. */
const MAX_PERSONS = 6;
const NOBODY: readonly number[] = [];

/** The other persons of the same file, who stand where they stood. */
function usePersons(document: TakeDocument, session: Session) {
  const [asked, setAsked] = useJsonParameter<readonly number[]>("with", NOBODY);
  const shown = useMemo(() => {
    const wanted = Array.isArray(asked) ? asked : NOBODY;
    return document.persons.map((one) => one.take_id).filter((id) => wanted.includes(id)).slice(0, MAX_PERSONS);
  }, [asked, document.persons]);
  const { motions, fault } = useMotions(shown, session);
  const actors = useMemo<Actor[]>(() => motions.map((motion) => ({ motion, second: true })), [motions]);
  const toggle = (id: number) => {
    const next = shown.includes(id) ? shown.filter((one) => one !== id) : [...shown, id];
    setAsked(next.length === 0 ? null : next);
  };
  const panel =
    document.persons.length === 0 ? null : (
      <Panel title="Other persons of the file">
        {document.persons.map((one) => (
          <Group key={one.take_id} gap={8} wrap="nowrap">
            <Switch
              size="xs"
              label={one.name}
              checked={shown.includes(one.take_id)}
              disabled={shown.length === MAX_PERSONS && !shown.includes(one.take_id)}
              onChange={() => toggle(one.take_id)}
            />
            <Link href={takeAddress(one.name)}>open</Link>
          </Group>
        ))}
        {fault !== null && <Fault fault={fault} />}
      </Panel>
    );
  return { actors, panel };
}
