import { Title } from "@mantine/core";

export default function TakePage() {
  return (
    <div className="page">
      <Title order={1}>Take</Title>
    </div>
  );
}
