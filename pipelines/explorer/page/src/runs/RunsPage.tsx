import { Title } from "@mantine/core";

export default function RunsPage() {
  return (
    <div className="page">
      <Title order={1}>Runs</Title>
    </div>
  );
}
