import { Title } from "@mantine/core";

export default function AskPage() {
  return (
    <div className="page">
      <Title order={1}>Ask</Title>
    </div>
  );
}
