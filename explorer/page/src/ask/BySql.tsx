// SQL over the views of the archive: a text, a virtual table of the rows, and hits where rows name intervals.

import { Button, Group, SegmentedControl, Text } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";
import { useEffect, useMemo, useRef, useState } from "react";

import { get } from "../api/client";
import type { StoreFacts } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useRefine } from "./refine";
import { Results } from "./Results";
import { SaveBar } from "./SaveBar";
import { sqlBlock, SqlRows } from "./SqlRows";
import type { SqlAnswer, ViewFacts } from "./types";

const FIRST = "SELECT name AS take, 0 AS start, least(frames, 90) AS stop, class, actor\nFROM takes\nORDER BY random()\nLIMIT 60";

export function BySql({ store }: { store: StoreFacts }) {
  const [asked, setAsked] = useParameter("sql");
  const [text, setText] = useState(asked ?? FIRST);
  const [turn, setTurn] = useState(0);
  useEffect(() => {
    if (asked !== null) setText(asked);
  }, [asked]);
  const field = useRef<HTMLTextAreaElement>(null);
  const first = useQuery({
    ...sqlBlock(asked ?? "", turn, 0),
    enabled: asked !== null,
  });
  useSame(first.data);
  const run = () => {
    if (text.trim() === "") return;
    setAsked(text, true);
    setTurn((before) => before + 1);
  };
  const insert = (word: string) => {
    const area = field.current;
    if (area === null) return;
    const { selectionStart: start, selectionEnd: end } = area;
    setText(text.slice(0, start) + word + text.slice(end));
    requestAnimationFrame(() => {
      area.focus();
      area.setSelectionRange(start + word.length, start + word.length);
    });
  };
  return (
    <div className="ask-body">
      <section className="question sql-question" aria-label="The statement">
        <textarea
          ref={field}
          className="code"
          aria-label="SQL"
          spellCheck={false}
          rows={9}
          value={text}
          onChange={(event) => setText(event.currentTarget.value)}
          onKeyDown={(event) => {
            if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) {
              event.preventDefault();
              run();
            }
          }}
        />
        <Group gap={8} mt={6}>
          <Button size="compact-sm" onClick={run} loading={first.isFetching}>
            Run (Ctrl Enter)
          </Button>
          <Text size="xs" className="muted">
            It only reads.
          </Text>
        </Group>
        <Views onInsert={insert} />
      </section>
      <section className="answer" aria-label="Result">
        {first.isError && <Fault fault={first.error} />}
        {first.data !== undefined && <Result key={`${asked}/${turn}`} first={first.data} text={asked ?? ""} turn={turn} store={store} />}
      </section>
    </div>
  );
}

function Result({ first, text, turn, store }: { first: SqlAnswer; text: string; turn: number; store: StoreFacts }) {
  const [shown, setShown] = useState<"hits" | "table">(first.hits !== null && first.hits.length > 0 ? "hits" : "table");
  const refine = useRefine("sql");
  const many = first.counted ? first.total.toLocaleString("en") : `more than ${first.total.toLocaleString("en")}`;
  return (
    <>
      <Group gap={10} mb={6}>
        <Text size="sm" role="status" aria-live="polite">
          {many} {first.total === 1 ? "row" : "rows"}
          {first.kept < first.total && `, the first ${first.kept.toLocaleString("en")} are shown`}{" "}
          <span className="muted">· {(1000 * first.seconds).toFixed(0)} ms</span>
        </Text>
        {first.hits !== null && (
          <SegmentedControl
            size="xs"
            aria-label="Show the rows as"
            value={shown}
            onChange={(value) => setShown(value as "hits" | "table")}
            data={[
              { value: "hits", label: "Hits" },
              { value: "table", label: "Table" },
            ]}
          />
        )}
      </Group>
      {shown === "hits" && first.hits !== null ? (
        <>
          <SaveBar hits={first.hits} onRefine={refine} />
          <Some hits={first.hits} rateHz={store.rate_hz} />
        </>
      ) : (
        <SqlRows first={first} text={text} turn={turn} />
      )}
    </>
  );
}

/** Show hits a screen at a time: every figure is a motion that is fetched and drawn. */
function Some({ hits, rateHz }: { hits: NonNullable<SqlAnswer["hits"]>; rateHz: number }) {
  const [count, setCount] = useState(60);
  const some = useMemo(() => hits.slice(0, count), [hits, count]);
  return (
    <>
      <Results hits={some} rateHz={rateHz} />
      {count < hits.length && (
        <Button size="compact-sm" variant="default" onClick={() => setCount(count + 60)}>
          Show more hits
        </Button>
      )}
    </>
  );
}

function Views({ onInsert }: { onInsert: (word: string) => void }) {
  const views = useQuery({
    queryKey: ["version", "views"],
    queryFn: ({ signal }) => get<{ views: ViewFacts[] }>("/api/ask/views", signal),
  });
  return (
    <div className="views" aria-label="Views">
      <h2>Views</h2>
      {views.isError && <Fault fault={views.error} />}
      {views.data?.views.map((view) => (
        <details key={view.name}>
          <summary>{view.name}</summary>
          <Text size="xs" className="muted">
            {view.about}
          </Text>
          <button type="button" className="plain" onClick={() => onInsert(view.example)}>
            insert an example
          </button>
          <ul>
            {view.columns.map((column) => (
              <li key={column.name}>
                <button type="button" className="plain" title={column.about} onClick={() => onInsert(column.name)}>
                  {column.name}
                </button>{" "}
                <span className="muted">{column.type}</span>
              </li>
            ))}
          </ul>
        </details>
      ))}
    </div>
  );
}
