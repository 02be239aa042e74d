// The pages of the explorer, in the order of the navigation. Each is a chunk of its own, loaded when it is first shown.

import { type ComponentType, lazy, type LazyExoticComponent } from "react";

export interface Page {
  title: string;
  /** Address of the page in the navigation. */
  path: string;
  /** Pattern of the addresses that it answers (wouter). */
  pattern: string;
  /** Key after `g` that goes to it. */
  key: string;
  view: LazyExoticComponent<ComponentType>;
}

export const PAGES: readonly Page[] = [
  { title: "Archive", path: "/", pattern: "/", key: "a", view: lazy(() => import("../archive/ArchivePage")) },
  { title: "Take", path: "/take", pattern: "/take/:name?", key: "t", view: lazy(() => import("../take/TakePage")) },
  { title: "Ask", path: "/ask", pattern: "/ask/*?", key: "s", view: lazy(() => import("../ask/AskPage")) },
  { title: "Label", path: "/label", pattern: "/label/*?", key: "l", view: lazy(() => import("../label/LabelPage")) },
  { title: "Templates", path: "/templates", pattern: "/templates/*?", key: "p", view: lazy(() => import("../templates/TemplatesPage")) },
  { title: "Runs", path: "/runs", pattern: "/runs/*?", key: "r", view: lazy(() => import("../runs/RunsPage")) },
  { title: "Export", path: "/export", pattern: "/export/*?", key: "e", view: lazy(() => import("../export/ExportPage")) },
];
