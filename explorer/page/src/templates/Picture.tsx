// A template as a small picture of its matrix.

import { memo, useEffect, useMemo, useRef } from "react";

import { onTheme } from "../motion/colours";
import { drawMatrix, pictureValues } from "./draw";

const HEIGHT = 80;
const WIDTH = 150;

export const Picture = memo(function Picture({ picture, columns }: { picture: string; columns: number }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const values = useMemo(() => pictureValues(picture, columns), [picture, columns]);
  useEffect(() => {
    const shown = canvas.current;
    if (shown === null) return;
    const order = values.map((_, bit) => bit);
    const draw = () => drawMatrix(shown, values, { order, row: HEIGHT / order.length, column: WIDTH / columns });
    draw();
    return onTheme(draw);
  }, [values, columns]);
  return <canvas ref={canvas} role="presentation" style={{ width: WIDTH, height: HEIGHT }} />;
});
