import { Title } from "@mantine/core";

export default function ExportPage() {
  return (
    <div className="page">
      <Title order={1}>Export</Title>
    </div>
  );
}
