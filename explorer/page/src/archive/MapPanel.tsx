import { Button } from "@mantine/core";
import { notifications } from "@mantine/notifications";
import { useMemo, useState } from "react";
import { Link } from "wouter";

import { post } from "../api/client";
import { useStore } from "../api/queries";
import { ClassInput } from "../label/ClassInput";
import { addressOfTakes } from "./HandOn";
import { type ArchiveMap, type Legend, LONGEST_CHOICE, NO_FIT, NO_VALUE, packedIds, takesOf } from "./map";
import { MapSign } from "./MapSign";
import { useSelection } from "./selection";
import { count, counted, hours } from "./text";

interface Props {
  map: ArchiveMap;
  legend: Legend;
  column: string;
  chosen: ReadonlySet<number>;
  onChoose: (points: number[], more: boolean) => void;
  onKeep: () => void;
}

/** What is chosen and what can be done with it, and the legend. */
export function MapPanel({ map, legend, column, chosen, onChoose, onKeep }: Props) {
  const none = useMemo(() => legend.codes.reduce((sum, code) => sum + (code === NO_VALUE ? 1 : 0), 0), [legend]);
  const hidden = useMemo(() => legend.codes.reduce((sum, code) => sum + (code === NO_FIT ? 1 : 0), 0), [legend]);
  const choose = (code: number, more: boolean) =>
    onChoose([...legend.codes.keys()].filter((point) => legend.codes[point] === code), more);
  const row = (code: number, label: string, points: number) => (
    <li key={code}>
      <button type="button" title={`Choose these points: ${label}`} onClick={(event) => choose(code, event.shiftKey || event.ctrlKey || event.metaKey)}>
        <MapSign code={code} />
        <span className={code < 0 ? "muted" : ""}>{label}</span>
        <span className="muted number">{count(points)}</span>
      </button>
    </li>
  );
  return (
    <section className="map-panel" aria-label="Choice and legend">
      <Choice map={map} chosen={chosen} onChoose={onChoose} onKeep={onKeep} />
      <h2>{column}</h2>
      <ul className="map-legend" aria-label={`Signs of ${column}`}>
        {legend.labels.map((label, code) => (legend.counts[code] ?? 0) > 0 && row(code, label, legend.counts[code] ?? 0))}
        {none > 0 && row(NO_VALUE, column === "cluster" ? "in no cluster" : "none", none)}
      </ul>
      {hidden > 0 && <p className="muted">{counted(hidden, "point")} that do not fit the filters are faint.</p>}
    </section>
  );
}

function Choice({ map, chosen, onChoose, onKeep }: Pick<Props, "map" | "chosen" | "onChoose" | "onKeep">) {
  const { filters, where } = useSelection();
  const rateHz = useStore().data?.rate_hz ?? 30;
  const takes = useMemo(() => takesOf(map, chosen), [map, chosen]);
  const seconds = useMemo(
    () => [...chosen].reduce((sum, point) => sum + (map.stops[point] as number) - (map.starts[point] as number), 0) / rateHz,
    [map, chosen, rateHz],
  );
  const text = useMemo(() => packedIds(takes), [takes]);
  if (chosen.size === 0)
    return (
      <p className="muted">
        Nothing is chosen. Draw a lasso (<kbd>l</kbd>) or a box (<kbd>b</kbd>), or click in the legend; a click on a point opens its take.
      </p>
    );
  const within = [...filters.filter((one) => one.column !== "take_id"), { column: "take_id", chosen: text }];
  const windows = map.unit === "windows" ? `${counted(chosen.size, "window")} of ` : "";
  const tooMany = text.length > LONGEST_CHOICE;
  return (
    <div className="map-choice" role="group" aria-label="What is chosen">
      <p role="status">
        <strong>
          {windows}
          {counted(takes.length, "take")}
        </strong>{" "}
        chosen, {hours(seconds / 3600)}
      </p>
      <div className="map-actions">
        <Button size="compact-sm" disabled={tooMany} onClick={onKeep} title="Make the chosen takes a filter, for the table and the wall as well (o)">
          Only these
        </Button>
        <Button size="compact-sm" variant="default" disabled={tooMany} component={Link} href={addressOfTakes("/ask", { filters: within, where })}>
          Search within
        </Button>
        <Button size="compact-sm" variant="subtle" onClick={() => onChoose([], false)}>
          Choose nothing
        </Button>
      </div>
      {tooMany && <p className="muted">So many takes do not fit into an address; filter by a column first.</p>}
      <SaveAsClass map={map} chosen={chosen} />
    </div>
  );
}

/** Most labels of one request, as the server has it. */
const TOGETHER = 500;

/** Label the chosen points, whole takes or windows, as a class. */
function SaveAsClass({ map, chosen }: Pick<Props, "map" | "chosen">) {
  const store = useStore().data;
  const [name, setName] = useState("");
  const [saving, setSaving] = useState(false);
  if (store?.read_only === true) return null;
  const noun = map.unit === "takes" ? "whole take" : "window";
  const save = async () => {
    const points = [...chosen];
    let recorded = 0;
    setSaving(true);
    try {
      for (let first = 0; first < points.length; first += TOGETHER) {
        const positives = points.slice(first, first + TOGETHER).map((point) => ({
          take_id: map.takes[map.owner[point] as number],
          start: map.starts[point],
          stop: map.stops[point],
        }));
        recorded += (await post<{ recorded: number }>("/api/ask/labels", { class: name.trim(), positives })).recorded;
      }
      notifications.show({ message: <>{counted(recorded, "label")} of {name.trim()} saved in the store. <Link href="/label">Label</Link></> });
    } catch (fault) {
      const message = fault instanceof Error ? fault.message : String(fault);
      notifications.show({ color: "red", title: `${counted(recorded, "label")} saved, then an error`, message });
    }
    setSaving(false);
  };
  return (
    <form
      className="map-class"
      onSubmit={(event) => {
        event.preventDefault();
        if (name.trim() !== "") void save();
      }}
    >
      <ClassInput label={`Class of ${chosen.size === 1 ? `this ${noun}` : `these ${count(chosen.size)} ${noun}s`}`} value={name} onChange={setName} />
      <Button type="submit" size="compact-sm" variant="default" loading={saving} disabled={name.trim() === ""}>
        Save as labels
      </Button>
    </form>
  );
}
