import { Button } from "@mantine/core";
import { Link } from "wouter";

import { takeAddress } from "../app/address";
import { type ArchiveMap, clusterName } from "./map";
import { count, counted, hours, named } from "./text";

interface Props {
  map: ArchiveMap;
  onKeep: (cluster: number) => void;
}

const percent = (share: number) => `${Math.round(100 * share)} %`;

/** The clusters of the map as a table: what sets each apart, whose classes it holds, and typical takes. */
export function MapTable({ map, onKeep }: Props) {
  const alone = map.cluster.filter((one) => one < 0).length;
  const noun = map.unit === "takes" ? "take" : "window";
  return (
    <div className="sheet">
      <table className="map-table">
        <caption>
          {counted(map.clusters.length, "cluster")}, the largest first; {counted(alone, noun)} {alone === 1 ? "is" : "are"} in none.
        </caption>
        <thead>
          <tr>
            <th scope="col">cluster</th>
            <th scope="col">{noun}s</th>
            <th scope="col">time</th>
            <th scope="col">what sets it apart (share of frames here, and elsewhere)</th>
            <th scope="col">classes of its takes</th>
            <th scope="col">typical</th>
            <th scope="col">filter</th>
          </tr>
        </thead>
        <tbody>
          {map.clusters.map((one, number) => (
            <tr key={number}>
              <th scope="row">{clusterName(one, number)}</th>
              <td className="number">{count(one.points)}</td>
              <td className="number">{hours(one.hours)}</td>
              <td>
                {one.traits.length === 0
                  ? "nothing by more than a tenth of the frames"
                  : one.traits.map((trait) => `${trait.feature} ${percent(trait.share)} (${percent(trait.rest)})`).join("; ")}
              </td>
              <td>
                {one.classes
                  .slice(0, 4)
                  .map((entry) => `${entry.value === null ? "no class" : named(entry.value)} ${count(entry.takes)}`)
                  .join(", ")}
                {one.classes.length > 4 && `, ${one.classes.length - 4} more`}
              </td>
              <td>
                <ul>
                  {one.typical.map((point) => (
                    <li key={point}>
                      <PointLink map={map} point={point} />
                    </li>
                  ))}
                </ul>
              </td>
              <td>
                <Button size="compact-xs" variant="default" aria-label={`Only these: cluster ${clusterName(one, number)}`} onClick={() => onKeep(number)}>
                  Only these
                </Button>
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** Return the address of the take of a point, of windows with the interval. */
export function pointAddress(map: ArchiveMap, point: number): string {
  const name = map.names[map.owner[point] as number] as string;
  return map.unit === "takes" ? takeAddress(name) : takeAddress(name, map.starts[point], map.stops[point]);
}

function PointLink({ map, point }: { map: ArchiveMap; point: number }) {
  return <Link href={pointAddress(map, point)}>{map.names[map.owner[point] as number]}</Link>;
}
