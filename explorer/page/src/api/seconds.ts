// Frames as seconds, by the same rule of rounding as `ops/intervals.py`.

/** Return the seconds of a frame, or of a number of frames, as text without a unit: "22.67". Halves are rounded upwards. */
export function shownSeconds(frames: number, rateHz: number, digits = 2): string {
  const scale = 10 ** digits;
  return (Math.floor((scale * frames) / rateHz + 0.5) / scale).toFixed(digits);
}

/** Return the frame that begins nearest to a time in seconds, the later of two that are equally near. */
export function nearestFrame(seconds: number, rateHz: number): number {
  return Math.floor(seconds * rateHz + 0.5);
}
