import { Alert, Button, Code, Text } from "@mantine/core";
import { Component, type ReactNode } from "react";

import { ApiError } from "../api/client";

/** Show why a request failed, and the way out. */
export function Fault({ fault, retry }: { fault: unknown; retry?: () => void }) {
  const message = fault instanceof Error ? fault.message : String(fault);
  const command = fault instanceof ApiError ? fault.remedy?.command : undefined;
  return (
    <Alert color="red" variant="light" role="alert" title={fault instanceof ApiError && fault.type !== "KinedexError" ? fault.type : "Error"}>
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
