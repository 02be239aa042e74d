import "./doubts.css";

import { Loader, Text, Title } from "@mantine/core";
import { useQuery } from "@tanstack/react-query";

import { get } from "../api/client";
import { useStore } from "../api/queries";
import { useParameter, useParameters } from "../app/address";
import { Fault } from "../app/Fault";
import { useSame } from "../app/same";
import { count } from "../archive/text";
import { CauseFiles } from "./CauseFiles";
import { FileView } from "./FileView";
import type { Cause, Causes, Kind } from "./types";

const TITLES: Record<Kind, string> = { refused: "Refused", guessed: "Read by a guess", warned: "Warned of" };

/** Doubts: files that were refused, guessed or warned of, by cause, and one of them with its points to be named. */
export default function DoubtsPage() {
  const readOnly = useStore().data?.read_only !== false;
  const found = useQuery({
    queryKey: ["version", "doubts"],
    queryFn: ({ signal }) => get<Causes>("/api/doubts", signal),
    placeholderData: (old) => old,
  });
  const [kind] = useParameter("kind");
  const [cause] = useParameter("cause");
  const [root] = useParameter("root");
  const [source] = useParameter("file");
  const [person] = useParameter("person");
  useSame(found.data);
  if (found.isError) return <div className="page"><Fault fault={found.error} retry={() => void found.refetch()} /></div>;
  if (found.data === undefined) return <Loader m="md" size="sm" aria-label="Loading" />;
  const causes = found.data.causes;
  const chosen = causes.find((one) => one.kind === kind && one.cause === cause);
  return (
    <div className="page doubts-page">
      <div className="doubts-list">
        <Title order={1}>Files in doubt</Title>
        {causes.length === 0 && <Text size="sm">No file was refused, guessed or warned of.</Text>}
        {(["refused", "guessed", "warned"] as const).map((one) => (
          <KindCauses key={one} kind={one} causes={causes.filter((row) => row.kind === one)} chosen={chosen} />
        ))}
      </div>
      <div className="doubts-files">
        {chosen === undefined ? (
          causes.length > 0 && <Text size="sm" className="muted">{cause === null ? "Choose a cause." : "No file has this doubt any more."}</Text>
        ) : (
          <CauseFiles cause={chosen} readOnly={readOnly} />
        )}
      </div>
      <div className="doubts-file">
        {root !== null && source !== null && <FileView key={`${root} ${source}`} file={{ source_root: root, source, person: person ?? "" }} readOnly={readOnly} />}
      </div>
    </div>
  );
}

function KindCauses({ kind, causes, chosen }: { kind: Kind; causes: Cause[]; chosen: Cause | undefined }) {
  const set = useParameters();
  if (causes.length === 0) return null;
  return (
    <section aria-label={TITLES[kind]}>
      <Title order={2}>{TITLES[kind]}</Title>
      <ul className="doubts-buttons">
        {causes.map((one) => {
          const open = one.files - one.accepted;
          return (
            <li key={one.cause}>
              <button
                type="button"
                aria-current={one === chosen}
                onClick={() => set({ kind, cause: one.cause, root: null, file: null, person: null, named: null }, true)}
              >
                <span title={one.cause}>{one.cause}</span>
                <span className="number">{open > 0 ? count(open) : "accepted"}</span>
              </button>
            </li>
          );
        })}
      </ul>
    </section>
  );
}
