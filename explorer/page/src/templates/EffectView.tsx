// The effect of edits on takes that are held out, the threshold, and what becomes of an edited template.

import { Button, CopyButton, Group, NativeSelect, NumberInput, Switch, Table, Text } from "@mantine/core";
import { notifications } from "@mantine/notifications";
import { useState } from "react";
import { Link } from "wouter";

import { post } from "../api/client";
import type { Step } from "../api/lines";
import { shownSeconds } from "../api/seconds";
import { takeAddress } from "../app/address";
import { Fault } from "../app/Fault";
import { download } from "../ask/files";
import { SmallFigure } from "../motion/SmallFigure";
import type { Edits } from "./edits";
import { ThresholdCurve } from "./ThresholdCurve";
import type { Effect, EffectRow, Segments, TemplateFacts } from "./types";

export interface EffectViewProps {
  facts: TemplateFacts;
  edits: Edits;
  edited: boolean;
  /** The question that the answer is to, as JSON. */
  body: string;
  answer: Effect | undefined;
  fault: Error | null;
  /** True while the answer is that of an earlier edit. */
  old: boolean;
  /** How far the server is with the answer. */
  step: Step;
  compete: boolean;
  onTau: (tau: number | null) => void;
  onTruth: (source: string | null) => void;
  onCompete: (compete: boolean) => void;
  onEverything: (everything: boolean) => void;
  onReset: () => void;
}

/** The threshold, what becomes of the edits, and the table before and after. */
export function EffectView(props: EffectViewProps) {
  const { facts, edits, edited, body, answer, fault, old, step, compete, onTau, onTruth, onCompete, onEverything, onReset } = props;
  const tau = edits.tau ?? facts.tau;
  const training = answer?.training.edited ?? null;
  const usesTau = answer?.uses_tau ?? true;
  const save = async () => {
    try {
      const file = await post<{ name: string; text: string }>("/api/templates/file", JSON.parse(body));
      download(file.name, file.text, "text/yaml");
    } catch (reason) {
      notifications.show({ color: "red", title: "Error", message: reason instanceof Error ? reason.message : String(reason) });
    }
  };
  return (
    <>
      <Group gap={10} mt={10}>
        {usesTau && (
          <label className="effect-tau">
            τ{" "}
            <NumberInput
              size="xs"
              w={92}
              aria-label="Threshold τ"
              value={tau}
              min={0.001}
              max={1}
              step={0.005}
              decimalScale={4}
              onChange={(value) => typeof value === "number" && value > 0 && value <= 1 && onTau(value === facts.tau ? null : value)}
            />
          </label>
        )}
        {usesTau && training !== null && (
          <Button
            size="compact-sm"
            variant="default"
            onClick={() => onTau(Number(training.tau.toFixed(4)))}
            title={`It divides the clips of ${facts.class} from those of all other classes best, F = ${training.f.toFixed(3)}`}
          >
            τ = {training.tau.toFixed(3)}, best on training clips
          </Button>
        )}
        <Button size="compact-sm" variant="default" disabled={!edited} onClick={onReset}>
          Undo all edits
        </Button>
        <Button size="compact-sm" variant={edited ? "filled" : "default"} onClick={() => void save()}>
          Save as YAML
        </Button>
        <Switch
          size="xs"
          label="other classes compete"
          checked={compete}
          onChange={(event) => onCompete(event.currentTarget.checked)}
          title="On: the templates of all classes annotate, as in the pipeline. Off: this class alone."
        />
        {(answer?.truth.sources.length ?? 0) > 1 && (
          <NativeSelect
            size="xs"
            aria-label="Ground truth"
            data={[
              { value: "evaluation", label: "ground truth of the evaluation" },
              { value: "labels", label: "labels of people" },
            ]}
            value={answer?.truth.source ?? "evaluation"}
            onChange={(event) => onTruth(event.currentTarget.value === "evaluation" ? null : event.currentTarget.value)}
          />
        )}
      </Group>
      {fault !== null && <Fault fault={fault} />}
      {fault === null && answer === undefined && (
        <Text size="sm" role="status">
          Computing…{share(step)}
        </Text>
      )}
      {fault === null && answer !== undefined && <Before answer={answer} old={old} step={step} edited={edited} onEverything={onEverything} />}
      {fault === null && usesTau && training !== null && <ThresholdCurve training={training} used={tau} pipeline={facts.tau} name={facts.class} advice={answer?.advice ?? null} />}
    </>
  );
}

/** Return how far the work has gone, once that is known. */
const share = ({ done, total }: Step) => (total > 0 ? ` ${Math.floor((100 * done) / total)} %` : "");

const HOUR = 3600;

const MEASURES = [
  ["f1", "F (frames)"],
  ["p1", "P"],
  ["r1", "R"],
  ["f2", "F (segments)"],
  ["p2", "P"],
  ["r2", "R"],
] as const;

interface BeforeProps {
  answer: Effect;
  old: boolean;
  step: Step;
  edited: boolean;
  onEverything: (everything: boolean) => void;
}

function Before({ answer, old, step, edited, onEverything }: BeforeProps) {
  const { truth } = answer;
  const some = truth.takes < truth.all_takes;
  if (answer.missing !== "")
    return (
      <Text size="sm" role="status">
        {answer.missing} <Link href="/label">Label</Link> · <Link href="/runs?view=start">Runs</Link>
      </Text>
    );
  const base = answer.rows[0];
  return (
    <>
      <Text size="sm" role="status">
        {some ? `${truth.takes} of ${truth.all_takes} held-out takes, drawn at random` : `${truth.takes} held-out ${truth.takes === 1 ? "take" : "takes"}`} (
        {(truth.seconds / 60).toFixed(1)} {some && `of ${(truth.all_seconds / 60).toFixed(0)} `}minutes) with {truth.segments}{" "}
        {truth.segments === 1 ? "segment" : "segments"} of {answer.class}, by {truth.source === "labels" ? "labels of people" : `the ground truth of ${truth.stage ?? ""}`}
        {truth.among_examples > 0 && `; ${truth.among_examples} more are among its examples`}
        <span className="muted">
          {" "}
          · {(1000 * answer.seconds).toFixed(0)} ms{old ? ` · computing…${share(step)}` : ""}{" "}
        </span>
        {some && (
          <button type="button" className="templates-plain" onClick={() => onEverything(true)}>
            judge by all of them, which takes longer
          </button>
        )}
        {truth.all_seconds > HOUR && !some && (
          <button type="button" className="templates-plain" onClick={() => onEverything(false)}>
            judge by an hour of them
          </button>
        )}
      </Text>
      <div className="effect-table" tabIndex={0} role="region" aria-label="Before and after" data-old={old}>
        <Table verticalSpacing={3} maw={860}>
          <Table.Thead>
            <Table.Tr>
              <Table.Th>Template</Table.Th>
              {answer.uses_tau && <Table.Th>τ</Table.Th>}
              {MEASURES.map(([key, title]) => (
                <Table.Th key={key} className="number">
                  {title}
                  <span className="visually-hidden">{title.length > 1 ? "" : key.endsWith("1") ? " (frames)" : " (segments)"}</span>
                </Table.Th>
              ))}
              <Table.Th className="number">found</Table.Th>
              <Table.Th className="number">wrong</Table.Th>
            </Table.Tr>
          </Table.Thead>
          <Table.Tbody>
            {answer.rows.map((row) => (
              <Table.Tr key={`${row.template} ${row.threshold}`} data-current={row.threshold === (edited ? "used" : "pipeline")}>
                <Table.Td>{row.template === "learned" ? "as learned" : "edited"}</Table.Td>
                {row.tau !== null && (
                  <Table.Td>
                    {row.tau.toFixed(3)} <span className="muted">{WHICH[row.threshold]}</span>
                  </Table.Td>
                )}
                {MEASURES.map(([key]) => (
                  <Table.Td key={key} className="number">
                    {row[key]?.toFixed(3) ?? "–"}
                    {row.template === "edited" && base !== undefined && key.startsWith("f") && <Change row={row} base={base} name={key} />}
                  </Table.Td>
                ))}
                <Table.Td className="number">
                  {row.segments_manual_hit} of {row.segments_manual}
                </Table.Td>
                <Table.Td className="number">{row.segments_automatic - row.segments_automatic_hit}</Table.Td>
              </Table.Tr>
            ))}
          </Table.Tbody>
        </Table>
      </div>
    </>
  );
}

export interface EffectDetailsProps {
  answer: Effect;
  old: boolean;
  edited: boolean;
  compete: boolean;
  rateHz: number;
}

/** What the numbers mean, the segments that are wrong or missed, and the command of the pipeline. */
export function EffectDetails({ answer, old, edited, compete, rateHz }: EffectDetailsProps) {
  if (answer.missing !== "") return null;
  return (
    <>
      <Text size="sm" className="muted templates-text">
        P: precision, R: recall. Differences are to the first row. Annotated as the pipeline does it, by <code>method: {answer.method}</code>
        {answer.queries && " with its keyframe queries"}
        {compete ? ", with the templates of all classes" : ", by the templates of this class alone"}
        {answer.with.length > 0 && `; ${answer.class} also has ${answer.with.join(", ")}, as learned`}.
        {answer.uses_tau
          ? ` Best on training clips: the τ that divides the clips of ${answer.class} from those of all other classes best, by their least distance; its own clips made the template, so it is rather low than high.`
          : " The method has no threshold τ."}
      </Text>
      {answer.remarks.map((one) => (
        <Text key={one} size="sm" className="templates-remark">
          {one}
        </Text>
      ))}
      <Mistakes title="Found, but wrong" what="segments that overlap no true one, the nearest first" found={answer.wrong} rateHz={rateHz} old={old} />
      <Mistakes title="Missed" what="true segments that nothing overlaps" found={answer.missed} rateHz={rateHz} old={old} />
      {edited && (
        <div className="effect-pipeline">
          <Text size="sm">
            To annotate with it, save it, and run the pipeline again with the file{answer.uses_tau ? " and the τ" : ""}:
          </Text>
          <Group gap={6} wrap="nowrap">
            <code tabIndex={0}>{answer.pipeline}</code>
            <CopyButton value={answer.pipeline}>
              {({ copied, copy }) => (
                <Button size="compact-xs" variant="default" onClick={copy}>
                  {copied ? "Copied" : "Copy"}
                </Button>
              )}
            </CopyButton>
          </Group>
        </div>
      )}
    </>
  );
}

const WHICH: Record<EffectRow["threshold"], string> = { pipeline: "of the pipeline", used: "used", best: "best on training clips" };

function Change({ row, base, name }: { row: EffectRow; base: EffectRow; name: "f1" | "f2" | "p1" | "p2" | "r1" | "r2" }) {
  const [now, before] = [row[name], base[name]];
  if (now === null || before === null) return null;
  const by = now - before;
  return (
    <span className={by >= 0 ? "effect-better" : "effect-worse"}>
      {" "}
      {by >= 0 ? "+" : "−"}
      {Math.abs(by).toFixed(3)}
    </span>
  );
}

interface MistakesProps {
  title: string;
  what: string;
  found: Segments;
  rateHz: number;
  old: boolean;
}

function Mistakes({ title, what, found, rateHz, old }: MistakesProps) {
  const [open, setOpen] = useState(false);
  if (found.total === 0) return null;
  return (
    <details className="mistakes" open={open} onToggle={(event) => setOpen(event.currentTarget.open)} data-old={old}>
      <summary>
        {title}: {found.total} <span className="muted">{what}{found.segments.length < found.total ? `; the first ${found.segments.length}` : ""}</span>
      </summary>
      {open && (
        <ul className="clips">
          {found.segments.map((one) => (
            <li key={`${one.take_id} ${one.start} ${one.stop}`} className="clip">
              <Link href={takeAddress(one.take, one.start, one.stop)} title={`${one.take}, frames ${one.start} to ${one.stop}: open the take`}>
                <SmallFigure item={one} width={92} height={96} />
                <span className="clip-name">{one.take}</span>
              </Link>
              <span className="muted">
                {shownSeconds(one.start, rateHz)} to {shownSeconds(one.stop, rateHz)} s{one.cost === null ? "" : `, cost ${one.cost.toFixed(3)}`}
              </span>
            </li>
          ))}
        </ul>
      )}
    </details>
  );
}
