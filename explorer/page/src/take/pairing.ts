// Two takes in step: the frame of the one at each frame of the other.

/** Frames of the other take at the frames of an interval of this one. */
export interface Pairing {
  start: number;
  stop: number;
  frames: readonly number[];
}

/** Return the frame of the other take at a frame of this one; between two frames where they follow each other. */
export function partnerOf(pairing: Pairing, frame: number): number {
  const { frames, start } = pairing;
  const at = Math.min(Math.max(0, frame - start), frames.length - 1);
  const low = Math.floor(at);
  const one = frames[low] ?? 0;
  const other = frames[Math.min(low + 1, frames.length - 1)] ?? one;
  return other >= one && other - one <= 8 ? one + (other - one) * (at - low) : one;
}
