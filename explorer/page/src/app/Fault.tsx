import { Alert, Button, Code, Text } from "@mantine/core";
import { Component, type ReactNode } from "react";

import { ApiError } from "../api/client";

const TITLES: Record<number, string> = {
  0: "No connection",
  401: "This page is not known to the server",
  403: "This is not allowed here",
  404: "This is not there",
  408: "This took too long",
  409: "This was changed meanwhile",
};

function titleOf(fault: unknown): string {
  if (!(fault instanceof ApiError)) return "Error";
  return TITLES[fault.status] ?? (fault.status >= 500 ? "The server could not answer" : "This cannot be answered");
}

/** What a browser says of a part of the page that it could not load; the words are those of Chromium, Firefox and Safari. */
const NOT_LOADED = /dynamically imported module|module script failed/i;

function messageOf(fault: unknown): string {
  const message = fault instanceof Error ? fault.message : String(fault);
  if (!NOT_LOADED.test(message)) return message;
  return "a part of the page could not be loaded: the server does not answer, or has a newer page; is `kinedex explore` still running?";
}

/** Show why a request failed, and the way out. */
export function Fault({ fault, retry }: { fault: unknown; retry?: () => void }) {
  const message = messageOf(fault);
  const command = fault instanceof ApiError ? fault.remedy?.command : undefined;
  return (
    <Alert color="red" variant="light" role="alert" title={titleOf(fault)}>
      <Text size="sm" style={{ whiteSpace: "pre-wrap", overflowWrap: "anywhere" }}>
        {message}
      </Text>
      {command !== undefined && command.length > 0 && <Code block>{command.join(" ")}</Code>}
      {retry !== undefined && (
        <Button size="compact-sm" variant="default" mt="xs" onClick={retry}>
          Try again
        </Button>
      )}
    </Alert>
  );
}

/** Show a fault of the page itself in place of what is inside. */
export class FaultBoundary extends Component<{ children: ReactNode }, { fault: unknown }> {
  override state = { fault: null as unknown };

  static getDerivedStateFromError(fault: unknown) {
    return { fault };
  }

  override render() {
    if (this.state.fault === null) return this.props.children;
    return <Fault fault={this.state.fault} retry={() => window.location.reload()} />;
  }
}
