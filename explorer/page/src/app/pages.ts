// The pages of the explorer, in the order of the navigation. The first is part of the page itself, so that its takes are
// asked for at once; each of the others is a chunk of its own, loaded when it is first shown, or while nothing else is to
// be done.

import { type ComponentType, createElement, lazy, useState } from "react";

import ArchivePage from "../archive/ArchivePage";

export interface Page {
  title: string;
  /** Address of the page in the navigation. */
  path: string;
  /** Pattern of the addresses that it answers (wouter). */
  pattern: string;
  /** Key after `g` that goes to it. */
  key: string;
  view: ComponentType;
}

type Load = () => Promise<{ default: ComponentType }>;

const loads: Load[] = [];

/** Return the page of a chunk. Once that has been loaded the page is there at once: React would show a loader first, and
 * would let it stay for 300 ms. */
function later(load: Load): ComponentType {
  let loaded: ComponentType | null = null;
  const loading: Load = async () => {
    const made = await load();
    loaded = made.default;
    return made;
  };
  loads.push(loading);
  const awaited = lazy(loading);
  return () => {
    const [view] = useState(() => loaded ?? awaited);
    return createElement(view);
  };
}

export const PAGES: readonly Page[] = [
  { title: "Archive", path: "/", pattern: "/", key: "a", view: ArchivePage },
  { title: "Take", path: "/take", pattern: "/take/:name?", key: "t", view: later(() => import("../take/TakePage")) },
  { title: "Doubts", path: "/doubts", pattern: "/doubts", key: "d", view: later(() => import("../doubts/DoubtsPage")) },
  { title: "Ask", path: "/ask", pattern: "/ask", key: "s", view: later(() => import("../ask/AskPage")) },
  { title: "Label", path: "/label", pattern: "/label", key: "l", view: later(() => import("../label/LabelPage")) },
  { title: "Templates", path: "/templates", pattern: "/templates", key: "p", view: later(() => import("../templates/TemplatesPage")) },
  { title: "Runs", path: "/runs", pattern: "/runs", key: "r", view: later(() => import("../runs/RunsPage")) },
  { title: "Export", path: "/export", pattern: "/export", key: "e", view: later(() => import("../export/ExportPage")) },
];

/** Load the chunks of all pages, and make what draws takes, each in a moment in which nothing else is to be done. */
export async function loadPages(): Promise<void> {
  const stage = async () => (await import("../motion/Stage")).prepareStage();
  for (const load of [...loads, stage]) {
    await new Promise<void>((done) => {
      if ("requestIdleCallback" in window) requestIdleCallback(() => done());
      else setTimeout(done, 200);
    });
    await load().catch(() => {}); // a page that cannot be loaded says so when it is shown
  }
}
