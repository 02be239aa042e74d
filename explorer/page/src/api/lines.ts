// Answers that arrive line by line.

/** How far some work has gone; both are 0 until the work is known. */
export interface Step {
  done: number;
  total: number;
}

/** Yield the lines of a stream of text as they arrive. */
export async function* readLines(stream: ReadableStream<Uint8Array>): AsyncGenerator<string> {
  const reader = stream.getReader();
  const decoder = new TextDecoder();
  let pieces: string[] = [];
  try {
    for (;;) {
      const { done, value } = await reader.read();
      const text = done ? decoder.decode() : decoder.decode(value, { stream: true });
      const end = text.lastIndexOf("\n");
      if (end < 0) {
        pieces.push(text);
      } else {
        yield* (pieces.join("") + text.slice(0, end)).split("\n");
        pieces = [text.slice(end + 1)];
      }
      if (done) break;
    }
    const rest = pieces.join("");
    if (rest !== "") yield rest;
  } finally {
    reader.cancel().catch(() => {}); // a stream that failed cannot be cancelled: its reader knows why
  }
}
