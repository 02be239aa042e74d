// One pose of a keyframe query, and the time to the next one.

import { Autocomplete, CloseButton, Group, RangeSlider, Switch, Text } from "@mantine/core";
import { useState } from "react";

import type { Feature } from "../api/types";
import { SmallFigure } from "../motion/SmallFigure";
import { grouped, nextState, stateOf, withState } from "./poses";
import type { Gap, Pose } from "./types";

/** A frame that a pose was taken from, and the features that are on and off in it. */
export interface Seen {
  take_id: number;
  frame: number;
  on: string[];
  off: string[];
}

export interface PoseCardProps {
  place: number;
  pose: Pose;
  seen?: Seen;
  features: readonly Feature[];
  onChange: (pose: Pose) => void;
  onRemove: () => void;
}

const SIGNS = { on: "✓", off: "✕", any: "·" } as const;

export function PoseCard({ place, pose, seen, features, onChange, onRemove }: PoseCardProps) {
  const [typed, setTyped] = useState("");
  const fixed = features.filter((one) => stateOf(pose, one.name) !== "any");
  const add = (name: string) => {
    onChange(withState(pose, name, seen?.off.includes(name) === true ? "off" : "on"));
    setTyped("");
  };
  const chip = (feature: Feature) => {
    const state = stateOf(pose, feature.name);
    const here = seen === undefined ? "" : seen.on.includes(feature.name) ? "; on in the frame" : seen.off.includes(feature.name) ? "; off in the frame" : "";
    return (
      <button
        key={feature.name}
        type="button"
        className="feature"
        data-state={state}
        aria-label={`${feature.name}: ${state}${here}`}
        title={`${feature.description}${here}. Click: on, off, either.`}
        onClick={() => onChange(withState(pose, feature.name, nextState(state)))}
      >
        {SIGNS[state]} {feature.name}
        {seen?.on.includes(feature.name) === true && <sup>on</sup>}
      </button>
    );
  };
  return (
    <section className="pose" aria-label={`Pose ${place + 1}`}>
      <Group justify="space-between" wrap="nowrap">
        <Text size="sm" fw={600}>
          Pose {place + 1}
        </Text>
        <CloseButton size="sm" aria-label={`Remove pose ${place + 1}`} onClick={onRemove} />
      </Group>
      <div className="pose-body">
        {seen !== undefined && (
          <SmallFigure
            item={{ take_id: seen.take_id, start: seen.frame, stop: seen.frame + 1 }}
            width={70}
            height={90}
            moves={false}
            label={`The pose of frame ${seen.frame}`}
          />
        )}
        <div className="features">
          {fixed.length === 0 && (
            <Text size="xs" className="muted">
              anything: name a feature
            </Text>
          )}
          {fixed.map(chip)}
        </div>
      </div>
      <Autocomplete
        size="xs"
        aria-label={`Add a feature to pose ${place + 1}`}
        placeholder="add a feature by name"
        data={features.filter((one) => stateOf(pose, one.name) === "any").map((one) => one.name)}
        value={typed}
        onChange={setTyped}
        selectFirstOptionOnChange
        onOptionSubmit={(name) => {
          add(name);
          setTimeout(() => setTyped("")); // the field takes the name of the option after this
        }}
        onKeyDown={(event) => {
          if (event.key === "Enter" && features.some((one) => one.name === typed)) add(typed);
        }}
      />
      <details>
        <summary>All {features.length} features</summary>
        {grouped(features).map(([group, those]) => (
          <div key={group}>
            <Text size="xs" className="muted">
              {group}
            </Text>
            <div className="features">{those.map(chip)}</div>
          </div>
        ))}
      </details>
    </section>
  );
}

const LONGEST = 5;

export function TimeBetween({
  gap,
  rateHz,
  label,
  onChange,
}: {
  gap: Gap;
  rateHz: number;
  label: string;
  onChange: (gap: Gap) => void;
}) {
  const most = Math.max(LONGEST, Math.ceil(gap.high ?? gap.low));
  const high = gap.high ?? most;
  return (
    <div className="gap">
      <Group justify="space-between">
        <Text size="xs">
          {gap.high === null ? `at least ${gap.low.toFixed(2)} s later` : `${gap.low.toFixed(2)} to ${gap.high.toFixed(2)} s later`}
        </Text>
        <Switch
          size="xs"
          label="any time"
          checked={gap.high === null}
          onChange={(event) => onChange({ ...gap, high: event.currentTarget.checked ? null : most })}
        />
      </Group>
      <RangeSlider
        size="sm"
        min={0}
        max={most}
        step={1 / rateHz}
        minRange={0}
        value={[gap.low, Math.max(gap.low, high)]}
        label={(value) => `${value.toFixed(2)} s`}
        thumbFromLabel={`${label}: at least`}
        thumbToLabel={`${label}: at most`}
        onChange={([low, top]) => onChange({ low, high: gap.high === null && top >= most ? null : top })}
      />
    </div>
  );
}
