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

test("a stream that breaks off is a fault of its reader and of nobody else", async () => {
  const stream = new ReadableStream<Uint8Array>({
    start(controller) {
      controller.enqueue(new TextEncoder().encode('{"done": 1}\n'));
    },
    pull(controller) {
      controller.error(new DOMException("signal is aborted without reason", "AbortError"));
    },
  });
  const found: string[] = [];
  const reading = async () => {
    for await (const line of readLines(stream)) found.push(line);
  };
  await expect(reading()).rejects.toThrow("signal is aborted");
  await new Promise((done) => setTimeout(done)); // a promise that nobody handles fails the test from here
  expect(found).toEqual(['{"done": 1}']);
});
