import "./ask.css";

import { Loader, SegmentedControl, TextInput, Title } from "@mantine/core";
import { useDebouncedValue } from "@mantine/hooks";
import { useEffect, useState } from "react";

import { useStore } from "../api/queries";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { ByExample } from "./ByExample";
import { ByKeyframes } from "./ByKeyframes";
import { BySql } from "./BySql";
import { VerdictScope } from "./verdicts";

const WAYS = [
  { value: "example", label: "By example" },
  { value: "keyframes", label: "By keyframes" },
  { value: "sql", label: "By SQL" },
];

/** Ask the archive: three ways, one kind of list. */
export default function AskPage() {
  const [way, setWay] = useParameter("way");
  const [take] = useParameter("take");
  const [from] = useParameter("from");
  const [to] = useParameter("to");
  const [origin] = useParameter("of");
  const store = useStore();
  const shown = WAYS.some((one) => one.value === way) ? (way as string) : "example";
  if (store.isError) return <Fault fault={store.error} retry={() => void store.refetch()} />;
  if (store.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  const scope = shown === "example" ? `example ${origin ?? [take, from, to].join(" ")}` : shown;
  return (
    <VerdictScope value={scope}>
    <div className="page ask">
      <header className="ask-head">
        <Title order={1}>Ask</Title>
        <SegmentedControl
          size="xs"
          aria-label="How to ask"
          value={shown}
          onChange={(value) => setWay(value === "example" ? null : value, true)}
          data={WAYS}
        />
        {shown !== "sql" && <Where />}
      </header>
      {shown === "example" && <ByExample store={store.data} />}
      {shown === "keyframes" && <ByKeyframes store={store.data} />}
      {shown === "sql" && <BySql store={store.data} />}
    </div>
    </VerdictScope>
  );
}

/** The condition on takes, which is in the address. */
function Where() {
  const [where, setWhere] = useParameter("where");
  const [text, setText] = useState(where ?? "");
  const [settled] = useDebouncedValue(text, 400);
  useEffect(() => setText(where ?? ""), [where]);
  useEffect(() => {
    if (settled === text && settled !== (where ?? "")) setWhere(settled);
  }, [settled, text, where, setWhere]);
  return (
    <TextInput
      size="xs"
      className="ask-where"
      aria-label="Only takes for which this SQL condition holds"
      placeholder="all takes, or SQL: actor = 'ann' AND seconds > 5"
      value={text}
      onChange={(event) => setText(event.currentTarget.value)}
    />
  );
}
