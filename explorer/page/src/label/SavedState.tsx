// What is saved: shown as saved only after the server has answered that it is on disk.

import { Alert, Badge, Button, Group, Text } from "@mantine/core";

import { useTrouble } from "../api/events";
import { dismiss, retryNow, useDecisions } from "./decisions";
import type { Change } from "./edits";

export function SavedState() {
  const { pending, trouble, saved } = useDecisions();
  const connected = useTrouble() === "";
  if (pending.length === 0)
    return (
      <Badge role="status" variant="default" tt="none" data-testid="saved">
        {saved === 0 ? "Nothing to save" : `✓ Saved: ${saved.toLocaleString("en")} ${saved === 1 ? "decision" : "decisions"} of this tab`}
      </Badge>
    );
  if (trouble === "" && connected)
    return (
      <Badge role="status" variant="default" tt="none" data-testid="saved">
        Saving {pending.length}
      </Badge>
    );
  return (
    <Group gap={6} role="status">
      <Badge className="queue-no" variant="outline" tt="none" data-testid="saved">
        ⚠ Not saved: {pending.length} {pending.length === 1 ? "decision is" : "decisions are"} kept in this browser
      </Badge>
      <Text size="xs" className="muted">
        {trouble}
      </Text>
      <Button size="compact-xs" variant="default" onClick={retryNow}>
        Try now
      </Button>
    </Group>
  );
}

/** Decisions that the server refused, for instance since another tab was first. */
export function RefusedDecisions() {
  const { refused } = useDecisions();
  if (refused.length === 0) return null;
  return (
    <Alert color="orange" variant="light" role="alert" title={`${refused.length} not recorded`} my={6}>
      <ul className="label-refused">
        {refused.slice(-5).map((one) => (
          <li key={one.decision.id}>
            <Text size="sm">
              {one.decision.changes.map(described).join(", ")} ({one.decision.take}): {one.message}
            </Text>
            <Button size="compact-xs" variant="default" onClick={() => dismiss(one)}>
              I have seen it
            </Button>
          </li>
        ))}
      </ul>
    </Alert>
  );
}

function described(change: Change): string {
  switch (change.do) {
    case "draw":
      return `${change.class} in frames ${change.start} to ${change.stop}`;
    case "accept":
    case "reject":
      return `${change.do === "accept" ? "yes" : "no"} to ${change.class} in frames ${change.start} to ${change.stop}`;
    case "change": {
      const edges = change.start === undefined && change.stop === undefined ? "" : ` to [${change.start ?? "…"}:${change.stop ?? "…"}]`;
      return `change${change.class === undefined ? "" : ` to ${change.class}`}${edges}`;
    }
    case "restore":
      return "undo";
    default:
      return change.do;
  }
}
