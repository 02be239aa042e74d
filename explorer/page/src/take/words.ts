// The words of a take for drawing and reading: for each feature the number of frames in which it is on, summed up, so
// that a pixel that stands for a thousand frames costs as much as one that stands for one.

export interface Run {
  start: number;
  stop: number;
}

const STEP = 4096;

export class Words {
  readonly frames: number;
  private readonly low: Uint32Array;
  private readonly high: Uint32Array;
  private readonly sums: Int32Array[];
  private readonly lost: Int32Array;
  /** Frames that are summed up so far. */
  ready = 0;

  constructor(
    buffer: ArrayBuffer,
    readonly features: number,
  ) {
    const halves = new Uint32Array(buffer);
    this.frames = halves.length >> 1;
    this.low = new Uint32Array(this.frames);
    this.high = new Uint32Array(this.frames);
    for (let t = 0; t < this.frames; t++) {
      this.low[t] = halves[2 * t] as number;
      this.high[t] = halves[2 * t + 1] as number;
    }
    this.sums = Array.from({ length: features }, () => new Int32Array(this.frames + 1));
    this.lost = new Int32Array(this.frames + 1);
  }

  /** Sum up some more frames; returns whether all are done. */
  prepare(): boolean {
    const stop = Math.min(this.frames, this.ready + STEP);
    for (let t = this.ready; t < stop; t++) this.lost[t + 1] = (this.lost[t] as number) + (this.valid(t) ? 0 : 1);
    for (let bit = 0; bit < this.features; bit++) {
      const sums = this.sums[bit] as Int32Array;
      const half = bit < 32 ? this.low : this.high;
      const shift = bit & 31;
      let sum = sums[this.ready] as number;
      for (let t = this.ready; t < stop; t++) {
        if (this.lost[t + 1] === this.lost[t]) sum += ((half[t] as number) >>> shift) & 1;
        sums[t + 1] = sum;
      }
    }
    this.ready = stop;
    return stop === this.frames;
  }

  valid(frame: number): boolean {
    return this.low[frame] !== 0xffffffff || this.high[frame] !== 0xffffffff;
  }

  on(frame: number, bit: number): boolean {
    const half = (bit < 32 ? this.low[frame] : this.high[frame]) ?? 0;
    return this.valid(frame) && ((half >>> (bit & 31)) & 1) === 1;
  }

  /** Number of frames of an interval in which a feature is on. */
  onWithin(bit: number, start: number, stop: number): number {
    const sums = this.sums[bit] as Int32Array;
    return (sums[stop] as number) - (sums[start] as number);
  }

  /** Number of invalid frames of an interval. */
  lostWithin(start: number, stop: number): number {
    return (this.lost[stop] as number) - (this.lost[start] as number);
  }

  /** Return the run around a frame in which a feature stays on, off or invalid. */
  runAt(bit: number, frame: number): Run & { state: "on" | "off" | "invalid" } {
    const state = (t: number) => (this.valid(t) ? (this.on(t, bit) ? "on" : "off") : "invalid");
    const here = state(frame);
    let [start, stop] = [frame, frame + 1];
    while (start > 0 && state(start - 1) === here) start--;
    while (stop < this.frames && state(stop) === here) stop++;
    return { start, stop, state: here };
  }

  /** Return the runs in which a feature is on. */
  runs(bit: number): Run[] {
    const found: Run[] = [];
    let start = -1;
    for (let t = 0; t <= this.frames; t++) {
      const on = t < this.frames && this.on(t, bit);
      if (on && start < 0) start = t;
      if (!on && start >= 0) {
        found.push({ start, stop: t });
        start = -1;
      }
    }
    return found;
  }
}
