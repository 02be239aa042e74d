// Every colour and measure of the page that is not Mantine's own.

import { createTheme, type CSSVariablesResolver, Drawer, Loader, Modal } from "@mantine/core";

/** The page itself does not scroll; the lock would insert a style without the nonce, which the policy refuses. */
const DIALOG = {
  lockScroll: false,
  closeButtonProps: { "aria-label": "Close" },
  attributes: { header: { role: "none" } }, // a second banner otherwise
};

export const theme = createTheme({
  primaryColor: "blue",
  primaryShade: 8, // white on a lighter blue is too faint to read
  fontFamily: "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif",
  fontFamilyMonospace: "ui-monospace, SFMono-Regular, Menlo, Consolas, monospace",
  defaultRadius: "sm",
  fontSizes: { xs: "12px", sm: "13px", md: "14px", lg: "16px", xl: "18px" },
  spacing: { xs: "6px", sm: "10px", md: "14px", lg: "18px", xl: "26px" },
  headings: { sizes: { h1: { fontSize: "18px" }, h2: { fontSize: "15px" }, h3: { fontSize: "14px" } } },
  cursorType: "pointer",
  components: {
    Modal: Modal.extend({ defaultProps: DIALOG }),
    Drawer: Drawer.extend({ defaultProps: DIALOG }),
    Loader: Loader.extend({ defaultProps: { role: "status" } }), // an element without a role must not have a name
  },
});

/** Colours of classes, pairs of (on white, on near black), as reports/palette.py has them. */
export const CLASS_COLOURS: readonly (readonly [string, string])[] = [
  ["#4e66c5", "#5097ff"],
  ["#b18e15", "#decd48"],
  ["#7e032c", "#ca545d"],
  ["#0b5d2a", "#2d8949"],
  ["#c67597", "#ff99c3"],
  ["#5e96d4", "#78c7fd"],
  ["#d75a21", "#fd7562"],
  ["#593b11", "#a47726"],
  ["#09495f", "#627981"],
  ["#833ea7", "#a66cdc"],
  ["#06288e", "#2076c9"],
  ["#28842d", "#2eb370"],
  ["#876b01", "#b5a737"],
  ["#80647d", "#b59ab7"],
  ["#187b90", "#4da6bc"],
  ["#9d6bcd", "#d58efe"],
  ["#a72a6a", "#e166ab"],
  ["#718f76", "#94cf9f"],
  ["#a63d02", "#ecae86"],
  ["#653b69", "#985b93"],
];

/** Text on the tinted backgrounds of badges and alerts on white: Mantine's own are too faint to read. */
const TINTED = {
  "--mantine-color-red-light-color": "#a11414",
  "--mantine-color-orange-light-color": "#8f3206",
  "--mantine-color-yellow-light-color": "#744600",
  "--mantine-color-green-light-color": "#1b612a",
  "--mantine-color-teal-light-color": "#0a5a42",
  "--mantine-color-blue-light-color": "#0b5cad",
  "--mantine-color-violet-light-color": "#5a31b0",
  "--mantine-color-gray-light-color": "#3d444c",
};

/** The variables --kx-… of the page; a class i has the colour var(--kx-class-i). */
export const variables: CSSVariablesResolver = () => ({
  variables: {},
  light: {
    "--kx-surface": "#ffffff",
    "--kx-raised": "#f6f7f9",
    "--kx-line": "#dfe2e7",
    "--kx-text": "#1b1f24",
    "--kx-muted": "#59616c",
    "--kx-selected": "#dbe9fb",
    "--kx-left": "#1f6fc4",
    "--kx-right": "#c8402f",
    "--kx-middle": "#4a5260",
    "--kx-link": "#0b5cad",
    "--kx-warning": "#a1260d",
    "--mantine-color-error": "#a1260d",
    "--mantine-color-anchor": "#0b5cad",
    ...TINTED,
    ...classVariables(0),
  },
  dark: {
    "--kx-surface": "#17191d",
    "--kx-raised": "#1f2227",
    "--kx-line": "#343941",
    "--kx-text": "#e4e7eb",
    "--kx-muted": "#a2abb8",
    "--kx-selected": "#1e3a5c",
    "--kx-left": "#6cb2ff",
    "--kx-right": "#ff8a76",
    "--kx-middle": "#b4bcc8",
    "--kx-link": "#7ab8ff",
    "--kx-warning": "#ff9c85",
    "--mantine-color-error": "#ff9c85",
    ...classVariables(1),
  },
});

function classVariables(side: 0 | 1): Record<string, string> {
  return Object.fromEntries(CLASS_COLOURS.map((pair, index) => [`--kx-class-${index}`, pair[side]]));
}

/** The colour of the class at a place in the sorted list of classes. */
export function classColour(index: number): string {
  return `var(--kx-class-${index % CLASS_COLOURS.length})`;
}
