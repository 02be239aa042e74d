// The state of a take that is shown: time, view and selection. What changes at every picture stays out of React: parts
// register a painter, and one loop calls those that have something to draw.

import { moved, showing, type View, within, zoomed } from "./axis";

export interface Shown {
  playing: boolean;
  speed: number;
  loop: boolean;
  follow: boolean;
  trails: boolean;
  /** Frames [from, to) that are selected. */
  selection: readonly [number, number] | null;
}

/** What has changed since a painter was called last. */
export interface Changes {
  time: boolean;
  view: boolean;
  content: boolean;
}

export type Painter = (changes: Changes) => void;

const REST_MS = 250;

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4] as const;

export class Session {
  /** The playhead: a fraction of a frame while it plays. */
  frame = 0;
  /** The frame under the pointer, whose pose is shown meanwhile. */
  hovered: number | null = null;
  /** Selection that is being drawn. */
  brushed: readonly [number, number] | null = null;
  view: View;
  /** Fulfilled once the first poses are there, or will not come: what is less urgent is asked for then. */
  readonly begun: Promise<void>;
  begin: () => void = () => {};
  shown: Shown = { playing: false, speed: 1, loop: true, follow: true, trails: false, selection: null };

  private readonly painters = new Set<Painter>();
  private readonly listeners = new Set<() => void>();
  private readonly rests = new Set<() => void>();
  private changes: Changes = { time: true, view: true, content: true };
  private request = 0;
  private before = 0;
  private ended = false;
  private pause: ReturnType<typeof setTimeout> | undefined;

  constructor(
    readonly frames: number,
    readonly rateHz: number,
  ) {
    this.view = { from: 0, to: Math.max(1, frames) };
    this.begun = new Promise((done) => {
      this.begin = done;
    });
  }

  /** The frame whose pose is shown. */
  get seen(): number {
    return this.hovered ?? this.frame;
  }

  paint(painter: Painter): () => void {
    this.painters.add(painter);
    this.changed("content");
    return () => this.painters.delete(painter);
  }

  subscribe = (listener: () => void): (() => void) => {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  };

  /** Call a function whenever playhead and selection have come to rest. */
  onRest(listener: () => void): () => void {
    this.rests.add(listener);
    return () => this.rests.delete(listener);
  }

  changed(...what: (keyof Changes)[]): void {
    for (const one of what) this.changes[one] = true;
    if (this.request === 0 && !this.ended) this.request = requestAnimationFrame(this.tick);
  }

  private readonly tick = (now: number): void => {
    this.request = 0;
    if (this.shown.playing) this.advance(now);
    const changes = this.changes;
    this.changes = { time: false, view: false, content: false };
    for (const painter of this.painters) painter(changes);
    if (this.shown.playing) this.changed("time");
  };

  private advance(now: number): void {
    const seconds = Math.min(0.25, Math.max(0, (now - this.before) / 1000));
    this.before = now;
    const [begin, end] = this.limits();
    let frame = this.frame + seconds * this.rateHz * this.shown.speed;
    if (frame >= end) {
      if (this.shown.loop) frame = begin + ((frame - begin) % Math.max(1, end - begin));
      else {
        frame = end - 1;
        this.set({ playing: false });
      }
    }
    this.frame = Math.min(frame, this.frames - 1 + 0.999);
    this.keepInView();
  }

  private limits(): readonly [number, number] {
    const { loop, selection } = this.shown;
    const inside = selection !== null && this.frame >= selection[0] && this.frame <= selection[1];
    return loop && inside ? selection : [0, this.frames];
  }

  private keepInView(): void {
    const view = showing(this.view, this.frame, this.frames);
    if (view !== this.view) {
      this.view = view;
      this.changed("view");
    }
    this.changed("time");
  }

  private set(values: Partial<Shown>): void {
    this.shown = { ...this.shown, ...values };
    for (const listener of this.listeners) listener();
    this.changed("time");
  }

  /** Report a rest when nothing has moved for a while: scrubbing writes no addresses. */
  private rested(): void {
    clearTimeout(this.pause);
    if (this.shown.playing || this.rests.size === 0) return;
    this.pause = setTimeout(() => {
      if (!this.shown.playing) for (const listener of this.rests) listener();
    }, REST_MS);
  }

  play(on = !this.shown.playing): void {
    if (on === this.shown.playing) return;
    this.before = performance.now();
    const { loop, selection } = this.shown;
    if (on && loop && selection !== null && (this.frame < selection[0] || this.frame >= selection[1] - 1))
      this.frame = selection[0];
    else if (on && this.frame >= this.frames - 1) this.frame = 0;
    this.hovered = null;
    this.set({ playing: on });
    if (!on) {
      this.frame = Math.floor(this.frame);
      this.rested();
    }
  }

  /** Put the playhead on a frame. */
  seek(frame: number, show = true): void {
    this.frame = Math.min(Math.max(0, frame), this.frames - 1);
    if (show) this.keepInView();
    this.changed("time");
    this.rested();
  }

  step(by: number): void {
    this.play(false);
    this.hovered = null;
    this.seek(Math.floor(this.frame) + by);
  }

  hover(frame: number | null): void {
    const seen = frame === null ? null : Math.min(Math.max(0, frame), this.frames - 1);
    if (seen === this.hovered) return;
    this.hovered = seen;
    this.changed("time");
  }

  select(selection: readonly [number, number] | null): void {
    this.brushed = null;
    this.set({ selection: selection === null ? null : ordered(selection, this.frames) });
    this.rested();
  }

  brush(selection: readonly [number, number] | null): void {
    this.brushed = selection === null ? null : ordered(selection, this.frames);
    this.changed("time");
  }

  setView(view: View): void {
    this.view = within(view, this.frames);
    this.changed("view", "time");
  }

  zoom(factor: number, around = this.frame): void {
    const inside = Math.min(Math.max(around, this.view.from), this.view.to);
    this.setView(zoomed(this.view, factor, inside, this.frames));
  }

  pan(by: number): void {
    this.setView(moved(this.view, by, this.frames));
  }

  choose(values: Partial<Pick<Shown, "speed" | "loop" | "follow" | "trails">>): void {
    this.set(values);
  }

  end(): void {
    this.ended = true;
    cancelAnimationFrame(this.request);
    clearTimeout(this.pause);
    this.painters.clear();
  }
}

/** Return an interval of whole frames, at least one, within a take. */
export function ordered([one, other]: readonly [number, number], frames: number): [number, number] {
  const from = Math.max(0, Math.min(frames - 1, Math.floor(Math.min(one, other))));
  const to = Math.min(frames, Math.max(from + 1, Math.ceil(Math.max(one, other))));
  return [from, to];
}
