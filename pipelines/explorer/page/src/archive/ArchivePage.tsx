import { Title } from "@mantine/core";

export default function ArchivePage() {
  return (
    <div className="page">
      <Title order={1}>Archive</Title>
    </div>
  );
}
