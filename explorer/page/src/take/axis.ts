// The time axis of the lanes: which frames are seen, and where.

import { roundedSeconds } from "../api/seconds";

export interface View {
  /** First frame that is seen; a fraction while somebody zooms. */
  from: number;
  /** Frame after the last. */
  to: number;
}

/** Least frames that are seen. */
const LEAST = 8;

/** Return a view that lies within the frames of a take. */
export function within(view: View, frames: number): View {
  const most = Math.max(frames, 1);
  const width = Math.min(most, Math.max(Math.min(LEAST, most), view.to - view.from));
  const from = Math.min(Math.max(0, view.from), most - width);
  return { from, to: from + width };
}

/** Zoom by a factor (above 1: closer) around a frame, which stays where it is. */
export function zoomed(view: View, factor: number, around: number, frames: number): View {
  const width = Math.min(Math.max(frames, 1), Math.max(Math.min(LEAST, frames), (view.to - view.from) / factor));
  const share = (around - view.from) / (view.to - view.from);
  return within({ from: around - share * width, to: around + (1 - share) * width }, frames);
}

export function moved(view: View, by: number, frames: number): View {
  return within({ from: view.from + by, to: view.to + by }, frames);
}

/** Return a view that shows a frame: the same one where it does, or else one that turns the page like a book. */
export function showing(view: View, frame: number, frames: number): View {
  const width = view.to - view.from;
  if (frame < view.from) return within({ from: frame - 0.9 * width, to: frame + 0.1 * width }, frames);
  if (frame >= view.to && view.to < frames) return within({ from: frame - 0.1 * width, to: frame + 0.9 * width }, frames);
  return view;
}

export const frameAt = (view: View, x: number, width: number): number =>
  view.from + (x / Math.max(1, width)) * (view.to - view.from);

export const xOf = (view: View, frame: number, width: number): number =>
  ((frame - view.from) / (view.to - view.from)) * width;

/** Return the view in which the frames under two fingers stay under them. */
export function pinched(view: View, before: [number, number], after: [number, number], width: number): View {
  const [one, other] = before.map((x) => frameAt(view, x, width)) as [number, number];
  const spread = (after[1] - after[0]) * Math.sign(before[1] - before[0]);
  if (Math.abs(before[1] - before[0]) < 1 || spread < 1) return view;
  const seen = (Math.abs(other - one) / spread) * width;
  const from = one - (after[0] / width) * seen;
  return { from, to: from + seen };
}

const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];

/** Return the seconds of the ticks of a view, at least so many pixels apart. */
export function ticks(view: View, rateHz: number, width: number, apart = 80): number[] {
  const seconds = (view.to - view.from) / rateHz;
  const step = STEPS.find((one) => (one / seconds) * width >= apart) ?? 7200;
  const found: number[] = [];
  for (let k = Math.ceil(view.from / rateHz / step - 1e-9); k * step <= view.to / rateHz + 1e-9; k++)
    found.push(Math.max(0, Math.round(k * step * 10) / 10));
  return found;
}

/** Write seconds as 12.3 s, or 4:05.0 from one minute on. */
export function clock(seconds: number, digits = 1): string {
  if (seconds < 60) return `${seconds.toFixed(digits)} s`;
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(digits).padStart(digits > 0 ? 3 + digits : 2, "0")}`;
}

/** Write the seconds of a frame, or of a number of frames, as `clock` does. */
export const frameClock = (frames: number, rateHz: number, digits = 2): string =>
  clock(roundedSeconds(frames, rateHz, digits), digits);
