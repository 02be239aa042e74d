import { Title } from "@mantine/core";

export default function LabelPage() {
  return (
    <div className="page">
      <Title order={1}>Label</Title>
    </div>
  );
}
