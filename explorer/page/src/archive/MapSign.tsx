// The signs of points: a colour and a shape for each value, so that nobody needs to tell colours apart.

import { classColour } from "../app/theme";

/** The shapes in the order in which they are given, as paths in a square from −1 to 1. */
export const SHAPES = [
  "M0.85 0A0.85 0.85 0 1 1 -0.85 0A0.85 0.85 0 1 1 0.85 0Z",
  "M-0.75 -0.75H0.75V0.75H-0.75Z",
  "M0 -1L1 0L0 1L-1 0Z",
  "M0 -0.9L1 0.8H-1Z",
  "M-0.28 -0.95H0.28V-0.28H0.95V0.28H0.28V0.95H-0.28V0.28H-0.95V-0.28H-0.28Z",
  "M-0.9 -0.5L-0.5 -0.9L0 -0.4L0.5 -0.9L0.9 -0.5L0.4 0L0.9 0.5L0.5 0.9L0 0.4L-0.5 0.9L-0.9 0.5L-0.4 0Z",
] as const;

/** The sign of a value; a code below 0 has a small grey dot. */
export function MapSign({ code }: { code: number }) {
  return (
    <svg className="map-sign" viewBox="-1.1 -1.1 2.2 2.2" width={13} height={13} aria-hidden focusable="false">
      <path
        d={SHAPES[Math.max(0, code) % SHAPES.length]}
        fill={code < 0 ? "var(--kx-muted)" : classColour(code)}
        transform={code < 0 ? "scale(0.6)" : undefined}
      />
    </svg>
  );
}
