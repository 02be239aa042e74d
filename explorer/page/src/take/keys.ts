// The keys of a page of a take; the list of keys of the page shows them.

import { useMemo } from "react";

import { type Shortcut, useShortcuts } from "../app/shortcuts";
import { type Session, SPEEDS } from "./session";

export function useKeys(session: Session, starts: readonly number[]): void {
  const shortcuts = useMemo<Shortcut[]>(() => {
    const by = (event: KeyboardEvent) => (event.shiftKey ? Math.round(session.rateHz) : 1);
    const speed = (step: number) => {
      const at = SPEEDS.indexOf(session.shown.speed as (typeof SPEEDS)[number]) + step;
      session.choose({ speed: SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, at))] });
    };
    const edge = (which: 0 | 1) => {
      const frame = Math.floor(session.frame);
      const [from, to] = session.shown.selection ?? [which === 0 ? frame : 0, which === 0 ? session.frames : frame + 1];
      session.select(which === 0 ? [frame, Math.max(frame + 1, to)] : [Math.min(from, frame), frame + 1]);
    };
    const jump = (frame: number | undefined) => frame !== undefined && session.seek(frame);
    return [
      { keys: " ", what: "Play or pause", run: () => session.play() },
      { keys: "ArrowLeft", what: "One frame back (with Shift one second)", run: (event) => session.step(-by(event)) },
      { keys: "ArrowRight", what: "One frame on (with Shift one second)", run: (event) => session.step(by(event)) },
      { keys: "Home", what: "To the beginning", run: () => session.seek(0) },
      { keys: "End", what: "To the end", run: () => session.seek(session.frames - 1) },
      { keys: "n", what: "To the next segment", run: () => jump(starts.find((one) => one > Math.floor(session.frame))) },
      { keys: "p", what: "To the previous segment", run: () => jump(starts.findLast((one) => one < Math.floor(session.frame))) },
      { keys: "[", what: "The selection begins here", run: () => edge(0) },
      { keys: "]", what: "The selection ends here", run: () => edge(1) },
      { keys: "Escape", what: "Clear the selection", run: () => session.select(null) },
      { keys: "+", what: "Zoom in", run: () => session.zoom(1.5) },
      { keys: "-", what: "Zoom out", run: () => session.zoom(1 / 1.5) },
      { keys: "0", what: "See the whole take", run: () => session.setView({ from: 0, to: session.frames }) },
      { keys: "PageUp", what: "Earlier lanes", run: () => session.pan(0.8 * (session.view.from - session.view.to)) },
      { keys: "PageDown", what: "Later lanes", run: () => session.pan(0.8 * (session.view.to - session.view.from)) },
      { keys: "<", what: "Slower", run: () => speed(-1) },
      { keys: ">", what: "Faster", run: () => speed(1) },
      { keys: "o", what: "Loop on or off", run: () => session.choose({ loop: !session.shown.loop }) },
      { keys: "f", what: "Follow the body or not", run: () => session.choose({ follow: !session.shown.follow }) },
      { keys: "y", what: "Trails of hands and feet on or off", run: () => session.choose({ trails: !session.shown.trails }) },
    ];
  }, [session, starts]);
  useShortcuts("Take", shortcuts);
}
