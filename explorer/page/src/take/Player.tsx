// The 3D player: a stage that follows the session of a take, and its controls.

import { ActionIcon, Button, Group, NativeSelect, Switch } from "@mantine/core";
import { useCallback, useEffect, useMemo, useRef, useState, useSyncExternalStore } from "react";

import { type Shortcut, useShortcuts } from "../app/shortcuts";
import type { Body } from "../motion/body";
import type { Actor, Staging } from "../motion/actors";
import { borrowStage, returnStage } from "../motion/Stage";
import { frameClock } from "./axis";
import { type Session, SPEEDS } from "./session";

export interface PlayerProps {
  session: Session;
  body: Body;
  actors: readonly Actor[];
  /** The frame of an actor at a frame of the session. */
  frameOf: (actor: number, frame: number) => number;
  label: string;
}

export function Player({ session, body, actors, frameOf, label }: PlayerProps) {
  const box = useRef<HTMLDivElement>(null);
  const note = useRef<HTMLDivElement>(null);
  const [stage, setStage] = useState<Staging | null>(null);
  const shown = useSyncExternalStore(session.subscribe, () => session.shown);
  useEffect(() => {
    let borrowed: Staging | null = null;
    // after the first picture of the page, when its questions are on their way
    const later = setTimeout(() => {
      borrowed = borrowStage();
      setStage(borrowed);
    }, 0);
    return () => {
      clearTimeout(later);
      setStage(null);
      if (borrowed !== null) returnStage(borrowed);
    };
  }, []);
  useEffect(() => {
    const place = box.current;
    if (stage === null || place === null) return;
    place.prepend(stage.canvas);
    const watch = new ResizeObserver(([entry]) => {
      if (entry === undefined) return;
      stage.resize(entry.contentRect.width, entry.contentRect.height);
      session.changed("content");
    });
    watch.observe(place);
    return () => watch.disconnect();
  }, [session, stage]);
  useEffect(() => stage?.canvas.setAttribute("aria-label", label), [stage, label]);
  useEffect(() => {
    if (stage === null) return;
    stage.setActors(actors, body);
    stage.onView = () => session.changed("content");
    let floored = false;
    const frames = actors.map(() => 0);
    return session.paint((changes) => {
      if (!changes.time && !changes.content) return;
      if (!floored) floored = putFloor(stage, actors[0], body);
      actors.forEach((_, i) => {
        frames[i] = frameOf(i, session.seen);
      });
      const known = stage.draw(frames, body);
      if (note.current !== null) note.current.hidden = known;
    });
  }, [session, stage, body, actors, frameOf]);
  useEffect(() => {
    if (stage === null) return;
    stage.follow = shown.follow;
    stage.trails = shown.trails;
    session.changed("content");
  }, [session, stage, shown.follow, shown.trails]);
  const front = useCallback(() => {
    stage?.reset();
    session.changed("content");
  }, [session, stage]);
  useCameraKeys(stage, front);
  return (
    <section className="player" aria-label="Player">
      <div ref={box} className="player-box">
        <div ref={note} className="player-note" hidden>
          no pose here yet
        </div>
        {stage?.flat === true && <div className="player-flat">This browser has no WebGL: bones are drawn as lines.</div>}
      </div>
      <Controls session={session} front={front} />
    </section>
  );
}

function useCameraKeys(stage: Staging | null, front: () => void): void {
  const shortcuts = useMemo<Shortcut[]>(
    () => [
      { keys: "c", what: "See the body from its front", run: front },
      { keys: "q", what: "Turn the camera to the left", run: () => stage?.turn(-0.15) },
      { keys: "e", what: "Turn the camera to the right", run: () => stage?.turn(0.15) },
      { keys: "z", what: "Closer", run: () => stage?.turn(0, 1 / 1.15) },
      { keys: "x", what: "Farther", run: () => stage?.turn(0, 1.15) },
    ],
    [stage, front],
  );
  useShortcuts("Camera", shortcuts);
}

/** Put the floor under the first poses where they stand far from height 0. */
function putFloor(stage: Staging, actor: Actor | undefined, body: Body): boolean {
  if (actor === undefined || actor.motion.stop === 0) return false;
  const pose = new Float32Array(3 * body.joints.length);
  const heights: number[] = [];
  const { first, stop } = actor.motion;
  for (let frame = first; frame < stop; frame += Math.max(1, (stop - first) >> 6)) {
    if (!actor.motion.pose(frame, pose)) continue;
    let least = Infinity;
    for (let i = 1; i < pose.length; i += 3) if ((pose[i] as number) < least) least = pose[i] as number;
    if (least < Infinity) heights.push(least);
  }
  heights.sort((a, b) => a - b);
  const usual = heights[Math.floor(heights.length * 0.2)] ?? 0;
  stage.setFloor(Math.abs(usual) > 0.15 ? usual : 0);
  return true;
}

function Controls({ session, front }: { session: Session; front: () => void }) {
  const shown = useSyncExternalStore(session.subscribe, () => session.shown);
  const slider = useRef<HTMLInputElement>(null);
  const now = useRef<HTMLSpanElement>(null);
  useEffect(
    () =>
      session.paint((changes) => {
        if (!changes.time && !changes.content) return;
        const frame = Math.floor(session.seen);
        const text = `${frameClock(frame, session.rateHz)} · frame ${frame}`;
        if (now.current !== null) now.current.textContent = text;
        if (slider.current === null) return;
        slider.current.value = String(Math.floor(session.frame));
        if (!session.shown.playing) slider.current.setAttribute("aria-valuetext", text);
      }),
    [session],
  );
  const button = (label: string, key: string, text: string, act: () => void, pressed?: boolean) => (
    <ActionIcon
      variant={pressed === true ? "filled" : "default"}
      aria-label={label}
      aria-pressed={pressed}
      title={`${label} (${key})`}
      onClick={act}
    >
      {text}
    </ActionIcon>
  );
  return (
    <div className="player-controls">
      <input
        ref={slider}
        type="range"
        min={0}
        max={Math.max(0, session.frames - 1)}
        defaultValue={0}
        step={1}
        aria-label="Time"
        onInput={(event) => session.seek(Number(event.currentTarget.value))}
      />
      <Group gap={6} wrap="wrap">
        {button("Previous frame", "←", "◂", () => session.step(-1))}
        {button(shown.playing ? "Pause" : "Play", "space", shown.playing ? "❚❚" : "▶", () => session.play())}
        {button("Next frame", "→", "▸", () => session.step(1))}
        <span ref={now} className="player-now" />
        <NativeSelect
          size="xs"
          w={72}
          aria-label="Speed"
          title="Speed (< and >)"
          value={String(shown.speed)}
          onChange={(event) => session.choose({ speed: Number(event.currentTarget.value) })}
          data={SPEEDS.map((speed) => ({ value: String(speed), label: `${speed}×` }))}
        />
        <Switch size="xs" label="Loop" checked={shown.loop} onChange={() => session.choose({ loop: !shown.loop })} />
        <Switch size="xs" label="Follow" checked={shown.follow} onChange={() => session.choose({ follow: !shown.follow })} />
        <Switch size="xs" label="Trails" checked={shown.trails} onChange={() => session.choose({ trails: !shown.trails })} />
        <Button size="compact-xs" variant="default" title="See the body from its front (c)" onClick={front}>
          Front
        </Button>
      </Group>
    </div>
  );
}
