import { useStore } from "../api/queries";
import { shownSeconds } from "../api/seconds";
import { SmallFigure } from "../motion/SmallFigure";
import type { ArchiveMap, Point } from "./map";
import { shownFrames } from "./wall";

interface Props {
  map: ArchiveMap;
  point: number;
  /** Where the pointer is; a point that keys have reached has its card in the corner. */
  at?: Point;
  text: string;
}

const WIDTH = 150;
const HEIGHT = 132;

/** A point: its take as a small moving figure, its name and value. */
export function MapHover({ map, point, at, text }: Props) {
  const rateHz = useStore().data?.rate_hz ?? 30;
  const owner = map.owner[point] as number;
  const first = map.starts[point] as number;
  const last = map.stops[point] as number;
  const [from, to] = shownFrames(last - first, rateHz);
  const seconds = (frames: number) => shownSeconds(frames, rateHz, 1);
  const style = at === undefined ? undefined : { left: `min(${at[0] + 16}px, calc(100% - ${WIDTH + 10}px))`, top: `min(${at[1] + 16}px, calc(100% - ${HEIGHT + 62}px))` };
  return (
    <div className="map-hover" style={style} data-corner={at === undefined} aria-hidden>
      {to > from && (
        <SmallFigure item={{ take_id: map.takes[owner] as number, start: first + from, stop: first + to }} width={WIDTH} height={HEIGHT} />
      )}
      <strong>{map.names[owner]}</strong>
      <span className="muted">
        {text} · {map.unit === "takes" ? `${seconds(last - first)} s` : `${seconds(first)} to ${seconds(last)} s`}
      </span>
    </div>
  );
}
