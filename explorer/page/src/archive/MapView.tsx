import "./map.css";

import { Progress, SegmentedControl, Select, Switch, Text } from "@mantine/core";
import { useCallback, useEffect, useMemo, useState } from "react";
import { useLocation } from "wouter";

import type { Step } from "../api/lines";
import { useStore } from "../api/queries";
import type { Selection } from "../api/types";
import { useJsonParameter, useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useShortcuts } from "../app/shortcuts";
import { type ArchiveMap, legendOf, type Legend, LONGEST_CHOICE, NO_FIT, packedIds, type Point, takesOf, type Unit, unpackedIds } from "./map";
import { MapCanvas, type Tool } from "./MapCanvas";
import { MapHover } from "./MapHover";
import { MapPanel } from "./MapPanel";
import { MapTable, pointAddress } from "./MapTable";
import { type Look, WHOLE } from "./mapPicture";
import { filterColumns, useSelection } from "./selection";
import { counted } from "./text";
import { useMap, useMapTakes } from "./useMap";

const CLUSTER = "-cluster";
const NOTHING: ReadonlySet<number> = new Set();

/** The takes of the archive, or windows of them, as points: the closer, the more alike. */
export function MapView({ selection }: { selection: Selection }) {
  const facts = useStore().data;
  const [unitText, setUnit] = useParameter("unit");
  const unit: Unit = unitText === "windows" ? "windows" : "takes";
  const found = useMap(unit);
  const [asked, setColour] = useParameter("colour");
  const columns = filterColumns(facts).map((one) => one.name);
  const colour = asked === CLUSTER || (asked !== null && columns.includes(asked)) ? asked : usual(unit, facts?.classes);
  const takes = useMapTakes(selection, colour === CLUSTER ? "class" : colour);
  const legend = useMemo(
    () =>
      found.map === undefined || takes.data === undefined || takes.data.column !== (colour === CLUSTER ? "class" : colour)
        ? undefined
        : legendOf(found.map, takes.data, colour === CLUSTER ? "cluster" : "column"),
    [found.map, takes.data, colour],
  );
  const [table, setTable] = useParameter("table");
  const [tool, setTool] = useState<Tool>("move");
  useShortcuts("Map", [
    { keys: "p", what: "Drag to move the map", run: () => setTool("move") },
    { keys: "b", what: "Drag a box around points", run: () => setTool("box") },
    { keys: "l", what: "Draw a lasso around points", run: () => setTool("lasso") },
    { keys: "t", what: "The map as a table, or back", run: () => setTable(table === null ? "1" : null) },
  ]);
  useSame(found.map);
  const fault = found.fault ?? takes.error;
  return (
    <div className="map-view">
      <div className="map-bar">
        <SegmentedControl
          size="xs"
          aria-label="What a point is"
          value={unit}
          onChange={(value) => setUnit(value === "takes" ? null : value, true)}
          data={[
            { value: "takes", label: "Takes" },
            { value: "windows", label: "Windows" },
          ]}
        />
        <span className="map-by">
          <span id="map-colour">Colours by</span>
          <Select
            size="xs"
            w={150}
            aria-labelledby="map-colour"
            data={[{ value: CLUSTER, label: "cluster" }, ...columns]}
            value={colour}
            onChange={(value) => setColour(value, true)}
            allowDeselect={false}
            searchable
          />
        </span>
        {table === null && (
          <SegmentedControl
            size="xs"
            aria-label="What dragging does"
            value={tool}
            onChange={(value) => setTool(value as Tool)}
            data={[
              { value: "move", label: "Move" },
              { value: "box", label: "Box" },
              { value: "lasso", label: "Lasso" },
            ]}
          />
        )}
        <Switch size="xs" label="Map as a table" checked={table !== null} onChange={() => setTable(table === null ? "1" : null, true)} />
      </div>
      {fault !== null ? (
        <Fault fault={fault} retry={found.fault === null ? undefined : found.retry} />
      ) : found.map === undefined || legend === undefined ? (
        <Waiting step={found.step} />
      ) : (
        <Shown key={`${unit} ${found.map.version}`} map={found.map} legend={legend} tool={tool} table={table !== null} column={colour === CLUSTER ? "cluster" : colour} />
      )}
    </div>
  );
}

/** Classes colour a map of takes that have some; windows of long takes have none of their own. */
function usual(unit: Unit, classes: readonly string[] | undefined): string {
  return unit === "takes" && (classes === undefined || classes.length > 0) ? "class" : CLUSTER;
}

function Waiting({ step }: { step: Step }) {
  return (
    <div className="map-waiting" role="status">
      <Text size="sm">
        The map is being computed{step.total > 0 ? `: step ${step.done} of ${step.total}` : ""}. It takes a core for seconds to a few
        minutes, and is kept until the takes change; leaving this view stops it.
      </Text>
      <Progress value={step.total > 0 ? (100 * step.done) / step.total : 100} animated={step.total === 0} aria-label="Progress of the map" />
    </div>
  );
}

interface ShownProps {
  map: ArchiveMap;
  legend: Legend;
  tool: Tool;
  table: boolean;
  column: string;
}

function Shown({ map, legend, tool, table, column }: ShownProps) {
  const state = useSelection();
  const [, navigate] = useLocation();
  const [look, setLook] = useJsonParameter<Look>("look", WHOLE);
  const sound = useMemo(() => (isLook(look) ? look : WHOLE), [look]);
  const [chosen, setChosen] = useChosen(map, legend);
  const [active, setActive] = useState(-1);
  const [pointed, setPointed] = useState<{ point: number; at: Point }>({ point: -1, at: [0, 0] });
  const onPointed = useCallback(
    (point: number, at: Point) => setPointed((before) => (before.point === point ? before : { point, at })),
    [],
  );
  const onLook = useCallback((next: Look) => setLook(next.zoom === 1 && next.x === 0 && next.y === 0 ? null : rounded(next)), [setLook]);
  const open = useCallback((point: number) => navigate(pointAddress(map, point)), [map, navigate]);
  const choose = useCallback(
    (points: number[], more: boolean) => {
      if (!more) return setChosen(new Set(points));
      const next = new Set(chosen);
      const [only] = points;
      if (points.length === 1 && only !== undefined && next.has(only)) next.delete(only);
      else for (const point of points) next.add(point);
      setChosen(next);
    },
    [chosen, setChosen],
  );
  const keep = (points: Iterable<number>) => {
    const text = packedIds(takesOf(map, points));
    if (text.length > LONGEST_CHOICE) return;
    state.put("take_id", { column: "take_id", chosen: text });
    setChosen(NOTHING);
  };
  const keepCluster = (number: number) => keep(map.cluster.flatMap((one, point) => (one === number ? [point] : [])));
  useShortcuts("Map", [{ keys: "o", what: "Only the chosen takes", run: () => chosen.size > 0 && keep(chosen) }]);
  const fitting = useMemo(() => legend.codes.reduce((sum, code) => sum + (code === NO_FIT ? 0 : 1), 0), [legend]);
  return (
    <>
      <div id="map-about" role="status" aria-live="polite" className="map-about">
        <strong>{counted(map.unit === "takes" ? map.takes.length : map.x.length, map.unit === "takes" ? "take" : "window")}</strong>
        {fitting < map.x.length && `, of which ${counted(fitting, "point")} fit the filters`}, {counted(map.clusters.length, "cluster")}.
        <span className="muted"> Neighbours move alike; directions and distances across the map mean little.</span>
        {map.remarks.map((remark) => (
          <span key={remark}> {remark}</span>
        ))}
        <span className="visually-hidden">{active >= 0 ? `At ${described(map, legend, active)}.` : ""}</span>
      </div>
      {table ? (
        <MapTable map={map} onKeep={keepCluster} />
      ) : (
        <div className="map-main">
          <div className="map-place">
            <MapCanvas
              map={map}
              legend={legend}
              chosen={chosen}
              look={sound}
              onLook={onLook}
              tool={tool}
              active={active}
              onActive={setActive}
              onChoose={choose}
              onOpen={open}
              onPointed={onPointed}
              describedBy="map-about"
            />
            {pointed.point >= 0 ? (
              <MapHover map={map} point={pointed.point} at={pointed.at} text={valueText(map, legend, pointed.point)} />
            ) : (
              active >= 0 && <MapHover map={map} point={active} text={valueText(map, legend, active)} />
            )}
          </div>
          <MapPanel map={map} legend={legend} column={column} chosen={chosen} onChoose={choose} onKeep={() => keep(chosen)} />
        </div>
      )}
    </>
  );
}

/** The chosen points. The address has their takes: a link to a map of windows opens it with all windows of these. */
function useChosen(map: ArchiveMap, legend: Legend): [ReadonlySet<number>, (points: ReadonlySet<number>) => void] {
  const [text, setText] = useParameter("chosen");
  const [points, setPoints] = useState<ReadonlySet<number>>(() => pointsOf(map, legend, text));
  const set = useCallback(
    (next: ReadonlySet<number>) => {
      setPoints(next.size === 0 ? NOTHING : next);
      const packed = next.size === 0 ? null : packedIds(takesOf(map, next));
      setText(packed !== null && packed.length > LONGEST_CHOICE ? null : packed);
    },
    [map, setText],
  );
  // What the filters hide is no longer chosen; the way back of the browser brings the choice before.
  useEffect(() => {
    const current = points.size === 0 ? null : packedIds(takesOf(map, points));
    if (text !== current && (current === null || current.length <= LONGEST_CHOICE)) setPoints(pointsOf(map, legend, text));
  }, [text]);
  return [points, set];
}

function pointsOf(map: ArchiveMap, legend: Legend, text: string | null): ReadonlySet<number> {
  if (text === null) return NOTHING;
  const ids = new Set(unpackedIds(text));
  const found = map.owner.flatMap((owner, point) => (ids.has(map.takes[owner] as number) && legend.codes[point] !== NO_FIT ? [point] : []));
  return new Set(found);
}

function isLook(look: unknown): look is Look {
  const one = look as Look | null;
  return typeof one === "object" && one !== null && [one.x, one.y, one.zoom].every(Number.isFinite) && one.zoom > 0;
}

function rounded({ x, y, zoom }: Look): Look {
  const short = (value: number) => Number(value.toPrecision(4));
  return { x: short(x), y: short(y), zoom: short(zoom) };
}

function valueText(map: ArchiveMap, legend: Legend, point: number): string {
  const cluster = map.cluster[point] as number;
  const parts = [legend.labels[legend.codes[point] as number], cluster < 0 ? "in no cluster" : `cluster ${cluster + 1}`];
  return [...new Set(parts)].filter((one) => one !== undefined).join(" · ");
}

function described(map: ArchiveMap, legend: Legend, point: number): string {
  return `${map.names[map.owner[point] as number]}, ${valueText(map, legend, point)}`;
}
