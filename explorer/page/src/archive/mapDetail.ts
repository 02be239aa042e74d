// Which points of the map a picture has: those in sight, and while the map moves one in each of many small cells.

/** What of the map is in sight, in units of the map. */
export interface Sight {
  x: number;
  y: number;
  /** Half of what is in sight, with the room of a sign beyond the edges. */
  reach: readonly [number, number];
}

/** More points in sight than this are thinned while the map moves: without a GPU, as many take some 15 ms to draw. */
export const PLENTY = 20_000;

/**
 * Write the points that are to be drawn into the end of `into`, in their order, and return the place of the first.
 *
 * Of points in the same square cell the one that is drawn last is kept. Cells lie fast on the map: a map that moves does
 * not flicker.
 */
export function pointsInSight(
  order: Uint32Array,
  xs: Float32Array,
  ys: Float32Array,
  { x, y, reach: [across, up] }: Sight,
  cell: number | null,
  into: Uint32Array,
): number {
  const columns = cell === null ? 0 : Math.floor((x + across) / cell) - Math.floor((x - across) / cell) + 1;
  const rows = cell === null ? 0 : Math.floor((y + up) / cell) - Math.floor((y - up) / cell) + 1;
  const taken = new Uint8Array(columns * rows);
  const side = cell ?? 1;
  const [left, low] = [Math.floor((x - across) / side), Math.floor((y - up) / side)];
  let first = into.length;
  for (let i = order.length - 1; i >= 0; i--) {
    const point = order[i] as number;
    const [u, v] = [xs[point] as number, ys[point] as number];
    if (Math.abs(u - x) > across || Math.abs(v - y) > up) continue;
    if (cell !== null) {
      const place = (Math.floor(v / side) - low) * columns + Math.floor(u / side) - left;
      if (taken[place] === 1) continue;
      taken[place] = 1;
    }
    into[--first] = point;
  }
  return first;
}
