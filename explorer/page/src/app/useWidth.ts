import { type RefObject, useEffect, useState } from "react";

/** Return the width of an element in whole pixels, 0 until it is known. */
export function useWidth(area: RefObject<HTMLDivElement | null>): number {
  const [width, setWidth] = useState(0);
  useEffect(() => {
    const box = area.current;
    if (box === null) return;
    const watch = new ResizeObserver(([entry]) => entry !== undefined && setWidth(Math.floor(entry.contentRect.width)));
    watch.observe(box);
    return () => watch.disconnect();
  }, [area]);
  return width;
}
