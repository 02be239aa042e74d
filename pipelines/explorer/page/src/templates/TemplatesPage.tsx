import { Title } from "@mantine/core";

export default function TemplatesPage() {
  return (
    <div className="page">
      <Title order={1}>Templates</Title>
    </div>
  );
}
