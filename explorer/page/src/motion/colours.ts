// Colours of the theme for canvases, read once for each theme instead of at every picture.

const names = [
  "surface",
  "raised",
  "line",
  "text",
  "muted",
  "selected",
  "left",
  "right",
  "middle",
] as const;

export type Colours = Record<(typeof names)[number], string> & { classes: string[]; dark: boolean };

let held: Colours | null = null;
const listeners = new Set<() => void>();

/** Return the colours of the theme that is shown. */
export function colours(): Colours {
  if (held === null) {
    const style = getComputedStyle(document.documentElement);
    const read = (name: string) => style.getPropertyValue(`--kx-${name}`).trim() || "#888888";
    const classes: string[] = [];
    for (let i = 0; style.getPropertyValue(`--kx-class-${i}`) !== ""; i++) classes.push(read(`class-${i}`));
    const dark = document.documentElement.getAttribute("data-mantine-color-scheme") === "dark";
    held = Object.assign(Object.fromEntries(names.map((name) => [name, read(name)])), { classes, dark }) as unknown as Colours;
  }
  return held;
}

/** Call a function when the theme changes; returns a function that ends that. */
export function onTheme(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

if (typeof document !== "undefined")
  new MutationObserver(() => {
    held = null;
    for (const listener of listeners) listener();
  }).observe(document.documentElement, { attributes: true, attributeFilter: ["data-mantine-color-scheme"] });
