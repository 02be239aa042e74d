import "./ask.css";

import { Loader, SegmentedControl, Title } from "@mantine/core";

import { useStore } from "../api/queries";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { FilterBar } from "../archive/FilterBar";
import { useSelection } from "../archive/selection";
import { ByExample } from "./ByExample";
import { ByKeyframes } from "./ByKeyframes";
import { BySql } from "./BySql";
import { originOf, VerdictScope } from "./verdicts";

const WAYS = [
  { value: "example", label: "By example" },
  { value: "keyframes", label: "By keyframes" },
  { value: "sql", label: "By SQL" },
];

const ON = [
  ["/", "Show these takes"],
  ["/export", "Export these"],
] as const;

/** Ask the archive: three ways, one kind of list. */
export default function AskPage() {
  const [way, setWay] = useParameter("way");
  const [take] = useParameter("take");
  const [from] = useParameter("from");
  const [to] = useParameter("to");
  const [origin] = useParameter("of");
  const store = useStore();
  const state = useSelection();
  const shown = WAYS.some((one) => one.value === way) ? (way as string) : "example";
  if (store.isError) return <Fault fault={store.error} retry={() => void store.refetch()} />;
  if (store.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  // what follows from hits of a question belongs to it, in whichever way it was asked
  const scope = shown === "example" ? (origin ?? [take, from, to].join(" ")) : originOf(shown);
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
        {shown !== "sql" && <FilterBar state={state} fault={null} to={ON} page="Ask" />}
      </header>
      {shown === "example" && <ByExample store={store.data} />}
      {shown === "keyframes" && <ByKeyframes store={store.data} />}
      {shown === "sql" && <BySql store={store.data} />}
    </div>
    </VerdictScope>
  );
}
