// The intervals of the archive that are most like the selection, as soon as it is made.

import { Text } from "@mantine/core";
import { useDebouncedValue, useLocalStorage } from "@mantine/hooks";
import { keepPreviousData, useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useState, useSyncExternalStore } from "react";
import { Link } from "wouter";

import { post } from "../api/client";
import { shownSeconds } from "../api/seconds";
import { takeAddress } from "../app/address";
import { Fault } from "../app/Fault";
import { type ExamplesAnswer, keyOf, samePlace } from "../ask/types";
import { SmallFigure } from "../motion/SmallFigure";
import type { Session } from "./session";

const SHOWN = 8;
const WAIT_MS = 150;
/** A page that opens with a selection shows the take first. */
const OPEN_MS = 1000;

export function AlikePanel({ session, id, name }: { session: Session; id: number; name: string }) {
  const { selection } = useSyncExternalStore(session.subscribe, () => session.shown);
  const [closed, setClosed] = useLocalStorage({ key: "kinedex-alike-closed", defaultValue: false, getInitialValueInEffect: false });
  const [settled] = useDebouncedValue(selection, WAIT_MS);
  const [opened, setOpened] = useState(false);
  useEffect(() => {
    const timer = setTimeout(() => setOpened(true), OPEN_MS);
    return () => clearTimeout(timer);
  }, []);
  if (selection === null || settled === null || !opened) return null;
  const [from, to] = settled;
  return (
    <details className="panel" open={!closed} onToggle={(event) => setClosed(!event.currentTarget.open)}>
      <summary>Most like the selection</summary>
      {!closed && <Alike id={id} name={name} from={from} to={to} rateHz={session.rateHz} />}
    </details>
  );
}

interface Props {
  id: number;
  name: string;
  from: number;
  to: number;
  rateHz: number;
}

function Alike({ id, name, from, to, rateHz }: Props) {
  const found = useQuery({
    queryKey: ["version", "alike", id, from, to],
    queryFn: ({ signal }) =>
      // one more than is shown, as the selection is found too
      post<ExamplesAnswer>("/api/ask/examples", { positives: [{ take_id: id, start: from, stop: to }], top: SHOWN + 1 }, signal),
    placeholderData: keepPreviousData,
  });
  const hits = useMemo(() => {
    const own = { take: name, start: from, stop: to, mirrored: false };
    return found.data?.hits.filter((hit) => !samePlace(hit, own)).slice(0, SHOWN);
  }, [found.data, name, from, to]);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (hits === undefined)
    return (
      <Text size="xs" className="muted" role="status">
        Searching…
      </Text>
    );
  if (hits.length === 0)
    return (
      <Text size="xs" className="muted" role="status">
        No other interval below τ {found.data?.tau}; “Search by this” allows a larger one.
      </Text>
    );
  return (
    <ol className="alike" aria-label="Most like the selection, the best first" aria-busy={found.isFetching}>
      {hits.map((hit) => (
        <li key={keyOf(hit)}>
          <Link href={takeAddress(hit.take, hit.start, hit.stop)} title={`${hit.take}, ${shownSeconds(hit.start, rateHz)} to ${shownSeconds(hit.stop, rateHz)} s`}>
            <SmallFigure item={hit} width={68} height={80} />
            <span>
              <span className="visually-hidden">{hit.take}, cost </span>
              {hit.cost?.toFixed(3)}
              {hit.mirrored && " mirror"}
            </span>
          </Link>
        </li>
      ))}
    </ol>
  );
}
