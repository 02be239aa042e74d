// Why an interval is of a class, or not: quantities with their numbers, beside those of the examples. It is asked for when
// it is first opened, as the examples of the whole store are compared.

import { Button, Loader, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";

import { get } from "../api/client";
import { useStore } from "../api/queries";
import type { Same } from "../api/types";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";

interface Reason {
  speaks: "for" | "against";
  text: string;
  share: number;
}

interface Explained extends Same {
  label: string;
  other: string;
  probability: number;
  other_probability: number;
  reasons: Reason[];
}

interface WhyProps {
  take_id: number;
  start: number;
  stop: number;
  /** The class; the most probable one unless given. */
  label?: string;
}

export function Why(props: WhyProps) {
  const [open, setOpen] = useState(false);
  return open ? (
    <Answer {...props} />
  ) : (
    <Button size="compact-sm" variant="default" my={6} onClick={() => setOpen(true)}>
      {props.label === undefined ? "Which class is it?" : "Why this class?"}
    </Button>
  );
}

function Answer({ take_id, start, stop, label }: WhyProps) {
  const chosen = label === undefined ? "" : `&class=${encodeURIComponent(label)}`;
  const found = useQuery({
    queryKey: ["version", "explain", take_id, start, stop, label, useStore().data?.version],
    queryFn: ({ signal }) => get<Explained>(`/api/takes/${take_id}/explain?start=${start}&stop=${stop}${chosen}`, signal),
    retry: false,
  });
  useSame(found.data);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return <Loader size="sm" aria-label="The examples are being compared" />;
  const { other, probability, other_probability, reasons } = found.data;
  return (
    <section aria-label="Why this class">
      <Text size="sm" mt={6}>
        {found.data.label} {percent(probability)}, {other} {percent(other_probability)}
      </Text>
      {(["for", "against"] as const).map((side) => {
        const own = reasons.filter((one) => one.speaks === side).slice(0, 6);
        return (
          own.length > 0 && (
            <div key={side}>
              <Text size="sm" fw={600} mt={4}>
                {side === "for" ? `For ${found.data.label}, beside ${other}` : `Against ${found.data.label}, beside ${other}`}
              </Text>
              <ul className="why">
                {own.map((one) => (
                  <li key={one.text}>{one.text}</li>
                ))}
              </ul>
            </div>
          )
        );
      })}
    </section>
  );
}

const percent = (share: number) => `${(100 * share).toFixed(0)} %`;
