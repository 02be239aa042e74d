// SQL over the views of the archive: a text, a virtual table of the rows, and hits where rows name intervals.

import { Button, Group, SegmentedControl, Text } from "@mantine/core";
import { useQueries, useQuery } from "@tanstack/react-query";
import { useVirtualizer } from "@tanstack/react-virtual";
import { useEffect, useMemo, useRef, useState } from "react";

import { get, post } from "../api/client";
import type { StoreFacts, Value } from "../api/types";
import { useParameter } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { useRefine } from "./refine";
import { Results } from "./Results";
import { SaveBar } from "./SaveBar";
import type { SqlAnswer, ViewFacts } from "./types";

const BLOCK = 200;
const ROW = 24;
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
    queryKey: ["version", "sql", asked, turn, 0],
    queryFn: ({ signal }) => post<SqlAnswer>("/api/ask/sql", { text: asked, offset: 0, limit: BLOCK }, signal),
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
        <Rows first={first} text={text} turn={turn} />
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

function Rows({ first, text, turn }: { first: SqlAnswer; text: string; turn: number }) {
  const frame = useRef<HTMLDivElement>(null);
  const virtual = useVirtualizer({
    count: first.kept,
    getScrollElement: () => frame.current,
    estimateSize: () => ROW,
    overscan: 12,
  });
  const items = virtual.getVirtualItems();
  const from = Math.floor((items[0]?.index ?? 0) / BLOCK);
  const to = Math.floor((items[items.length - 1]?.index ?? 0) / BLOCK);
  const blocks = useQueries({
    queries: Array.from({ length: to - from + 1 }, (_, i) => ({
      queryKey: ["version", "sql", text, turn, from + i],
      queryFn: ({ signal }: { signal: AbortSignal }) =>
        post<SqlAnswer>("/api/ask/sql", { text, offset: (from + i) * BLOCK, limit: BLOCK }, signal),
      enabled: from + i > 0,
    })),
  });
  const row = (index: number): Value[] | undefined => {
    const block = Math.floor(index / BLOCK);
    const rows = block === 0 ? first.rows : blocks[block - from]?.data?.rows;
    return rows?.[index % BLOCK];
  };
  const widths = first.columns.map((column) => {
    const longest = Math.max(column.name.length, ...first.rows.slice(0, 40).map((one, _i) => shownValue(one[first.columns.indexOf(column)]).length));
    return Math.min(360, Math.max(60, 8 * longest + 16));
  });
  const template = widths.map((width) => `${width}px`).join(" ");
  return (
    <div ref={frame} className="sql-rows" role="table" aria-label="Rows" aria-rowcount={first.kept + 1} tabIndex={0}>
      <div role="row" className="sql-row sql-head" style={{ gridTemplateColumns: template }} aria-rowindex={1}>
        {first.columns.map((column) => (
          <span key={column.name} role="columnheader" title={column.type}>
            {column.name}
          </span>
        ))}
      </div>
      <div role="rowgroup" style={{ height: virtual.getTotalSize(), position: "relative" }}>
        {items.map((item) => (
          <div
            key={item.key}
            role="row"
            aria-rowindex={item.index + 2}
            className="sql-row"
            style={{ gridTemplateColumns: template, transform: `translateY(${item.start}px)`, position: "absolute" }}
          >
            {first.columns.map((column, i) => {
              const value = row(item.index)?.[i];
              return (
                <span key={column.name} role="cell" className={typeof value === "number" ? "number" : undefined}>
                  {row(item.index) === undefined ? "…" : shownValue(value)}
                </span>
              );
            })}
          </div>
        ))}
      </div>
    </div>
  );
}

function shownValue(value: Value | undefined): string {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(8)));
  return typeof value === "object" ? JSON.stringify(value) : String(value);
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
