// Templates as matrices on a canvas: features from top to bottom, columns to the right; what is on is black in the light
// theme and white in the dark one, what varies among the clips is grey.

import { colours } from "../motion/colours";

/** Return the values of a picture in base64, from 0 to 1, feature by feature. */
export function pictureValues(picture: string, columns: number): number[][] {
  const bytes = Uint8Array.from(atob(picture), (letter) => letter.charCodeAt(0));
  const rows: number[][] = [];
  for (let at = 0; at < bytes.length; at += columns) rows.push(Array.from(bytes.subarray(at, at + columns), (one) => one / 200));
  return rows;
}

export interface MatrixLook {
  /** Features by their rows from top to bottom. */
  order: readonly number[];
  /** Height of a row and width of a column, in points. */
  row: number;
  column: number;
  /** Returns whether a feature counts, and a column is kept; the others are faint. */
  counts?: (bit: number, column: number) => boolean;
  /** True for differences, from −1 to 1, in two colours. */
  signed?: boolean;
}

export function drawMatrix(canvas: HTMLCanvasElement, values: readonly (readonly number[])[], look: MatrixLook): void {
  const theme = colours();
  const columns = values[0]?.length ?? 0;
  const dense = Math.min(2, window.devicePixelRatio || 1);
  const width = Math.round(columns * look.column * dense);
  const height = Math.round(look.order.length * look.row * dense);
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
  const pen = canvas.getContext("2d") as CanvasRenderingContext2D;
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.globalAlpha = 1;
  pen.fillStyle = theme.surface;
  pen.fillRect(0, 0, width, height);
  const edge = (column: number) => Math.round(column * look.column * dense);
  look.order.forEach((bit, place) => {
    const top = Math.round(place * look.row * dense);
    const tall = Math.max(1, Math.round((place + 1) * look.row * dense) - top - (look.row >= 8 ? dense : 0));
    const row = values[bit] ?? [];
    for (let column = 0; column < columns; column++) {
      const value = row[column] ?? 0;
      const faint = look.counts !== undefined && !look.counts(bit, column);
      pen.globalAlpha = (look.signed === true ? Math.abs(value) : value) * (faint ? 0.16 : 1);
      pen.fillStyle = look.signed !== true ? theme.text : value > 0 ? theme.left : theme.right;
      if (pen.globalAlpha > 0) pen.fillRect(edge(column), top, edge(column + 1) - edge(column), tall);
    }
  });
  pen.globalAlpha = 1;
}
