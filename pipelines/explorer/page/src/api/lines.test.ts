import { expect, test } from "vitest";

import { readLines } from "./lines";

test("lines arrive whole, however the bytes are cut", async () => {
  const bytes = new TextEncoder().encode('{"a": "ü"}\n\n{"b": 2}\n{"c": 3}');
  for (const length of [1, 2, 7, bytes.length]) {
    const stream = new ReadableStream<Uint8Array>({
      start(controller) {
        for (let from = 0; from < bytes.length; from += length) controller.enqueue(bytes.slice(from, from + length));
        controller.close();
      },
    });
    const found: string[] = [];
    for await (const line of readLines(stream)) found.push(line);
    expect(found).toEqual(['{"a": "ü"}', "", '{"b": 2}', '{"c": 3}']);
  }
});
