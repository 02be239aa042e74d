// The views of the Archive page beside the table of takes, in the order of their tabs; each is loaded when first shown.

import { type ComponentType, lazy, type LazyExoticComponent } from "react";

import type { Selection } from "../api/types";

export interface ArchiveView {
  key: string;
  title: string;
  /** True if it shows the takes that fit the filters; the bar of filters stands above it. */
  filtered: boolean;
  view: LazyExoticComponent<ComponentType<{ selection: Selection }>>;
}

export const VIEWS: readonly ArchiveView[] = [
  {
    key: "wall",
    title: "Wall",
    filtered: true,
    view: lazy(async () => ({ default: (await import("./WallView")).WallView })),
  },
  {
    key: "map",
    title: "Map",
    filtered: true,
    view: lazy(async () => ({ default: (await import("./MapView")).MapView })),
  },
  {
    key: "quality",
    title: "Quality",
    filtered: false,
    view: lazy(async () => ({ default: (await import("./QualityView")).QualityView })),
  },
  {
    key: "duplicates",
    title: "Duplicates",
    filtered: false,
    view: lazy(async () => ({ default: (await import("./RowsViews")).DuplicatesView })),
  },
  {
    key: "excluded",
    title: "Excluded files",
    filtered: false,
    view: lazy(async () => ({ default: (await import("./RowsViews")).ExcludedView })),
  },
];
