// Frames as seconds, by the same rule of rounding as `ops/intervals.py`.

/** Return the seconds of a frame, or of a number of frames, to so many digits; halves are rounded upwards. */
export function roundedSeconds(frames: number, rateHz: number, digits = 2): number {
  const scale = 10 ** digits;
  return Math.floor((scale * frames) / rateHz + 0.5) / scale;
}

/** Return the same as text without a unit: "22.67". */
export const shownSeconds = (frames: number, rateHz: number, digits = 2): string =>
  roundedSeconds(frames, rateHz, digits).toFixed(digits);

/** Return the frame that begins nearest to a time in seconds, the later of two that are equally near. */
export const nearestFrame = (seconds: number, rateHz: number): number => Math.floor(seconds * rateHz + 0.5);
