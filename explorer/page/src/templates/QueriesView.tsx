// Learned keyframe queries: their poses, their YAML, and the way to search with them.

import { Button, CopyButton, Group, Loader, NativeSelect, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { Link } from "wouter";

import { get } from "../api/client";
import type { StoreFacts } from "../api/types";
import { useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import type { Gap, Pose } from "../ask/types";
import { SmallFigure } from "../motion/SmallFigure";
import type { LearnedQuery, QueryList } from "./types";

export function QueriesView({ store }: { store: StoreFacts }) {
  const [stage] = useParameter("stage");
  const set = useParameters();
  const asked = stage === null ? "" : `?${new URLSearchParams({ stage }).toString()}`;
  const found = useQuery({
    queryKey: ["version", "learned-queries", asked],
    queryFn: ({ signal }) => get<QueryList>(`/api/queries${asked}`, signal),
  });
  useSame(found.data);
  if (found.isError) return <Fault fault={found.error} retry={() => void found.refetch()} />;
  if (found.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  const { stages, queries } = found.data;
  if (stages.length === 0)
    return (
      <Text size="sm">
        This store has no learned keyframe query. <code>kinedex keyframes learn {store.path}</code> learns them from its clips, and so does the pipeline
        keyframes on the page <Link href="/runs?view=start&pipeline=keyframes">Runs</Link>.
      </Text>
    );
  return (
    <>
      <div className="templates-tools">
        {stages.length > 1 && (
          <NativeSelect
            size="xs"
            aria-label="Stage that learned the queries"
            data={stages}
            value={found.data.stage}
            onChange={(event) => set({ stage: event.currentTarget.value }, true)}
          />
        )}
        <Text size="sm" className="muted" role="status">
          {queries.length} queries of {found.data.stage}. Precision and recall are those of all queries of a class together, on the training clips.
        </Text>
      </div>
      <ul className="queries">
        {queries.map((one) => (
          <li key={one.name}>
            <QueryCard one={one} />
          </li>
        ))}
      </ul>
    </>
  );
}

function QueryCard({ one }: { one: LearnedQuery }) {
  const address = `/ask?${new URLSearchParams({ way: "keyframes", yaml: one.text }).toString()}`;
  return (
    <section className="query" aria-label={one.name}>
      <Group justify="space-between" wrap="nowrap" align="flex-start">
        <div>
          <h2>{one.name}</h2>
          <Text size="sm" className="muted">
            {one.class === one.name ? "" : `of the class ${one.class}; `}precision {one.precision.toFixed(3)}, recall {one.recall.toFixed(3)}, fitness{" "}
            {one.fitness.toFixed(3)}; {one.runs} runs over {one.clips} clips, {one.origin}
          </Text>
        </div>
        <Button size="compact-sm" variant="default" component={Link} href={address}>
          Search with it
        </Button>
      </Group>
      {one.query === null ? (
        <Text size="sm">{one.sentence}</Text>
      ) : (
        <ol className="query-poses">
          {one.query.poses.map((pose, i) => (
            <li key={i}>
              {i > 0 && <span className="query-gap muted">{gapText(one.query?.gaps[i - 1])}</span>}
              <PoseShown pose={pose} place={i} seen={one.seen} />
            </li>
          ))}
        </ol>
      )}
      <details>
        <summary>As YAML</summary>
        <pre className="query-yaml" tabIndex={0}>{one.text}</pre>
        <CopyButton value={one.text}>
          {({ copied, copy }) => (
            <Button size="compact-xs" variant="default" onClick={copy}>
              {copied ? "Copied" : "Copy"}
            </Button>
          )}
        </CopyButton>
      </details>
    </section>
  );
}

function gapText(gap: Gap | undefined): string {
  if (gap === undefined) return "";
  return gap.high === null ? `at least ${gap.low.toFixed(2)} s later` : `${gap.low.toFixed(2)} to ${gap.high.toFixed(2)} s later`;
}

function PoseShown({ pose, place, seen }: { pose: Pose; place: number; seen: LearnedQuery["seen"] }) {
  const frame = seen?.frames[place];
  return (
    <div className="query-pose">
      {seen !== null && frame !== undefined && (
        <SmallFigure
          item={{ take_id: seen.take_id, start: frame, stop: frame + 1 }}
          width={76}
          height={92}
          moves={false}
          label={`Pose ${place + 1}: frame ${frame} of ${seen.take}`}
        />
      )}
      <ul>
        {pose.on.map((name) => (
          <li key={name} className="query-on">✓ {name}</li>
        ))}
        {pose.off.map((name) => (
          <li key={name} className="query-off">✕ {name}</li>
        ))}
      </ul>
    </div>
  );
}
