// Requests to the server. Every failure is an ApiError with a message that a person can act on.

import { readLines, type Step } from "./lines";

export interface Remedy {
  text: string;
  command: string[];
}

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly type: string,
    message: string,
    readonly remedy: Remedy | null = null,
  ) {
    super(message);
    this.name = "ApiError";
  }
}

interface Fault {
  type: string;
  message: string;
  remedy: Remedy | null;
}

async function failure(response: Response): Promise<ApiError> {
  try {
    const { error } = (await response.json()) as { error: Fault };
    return new ApiError(response.status, error.type, error.message, error.remedy);
  } catch {
    return new ApiError(response.status, "HTTPError", `the server answered with status ${response.status}`);
  }
}

function isAbort(fault: unknown): boolean {
  return fault instanceof DOMException && fault.name === "AbortError";
}

async function request(path: string, options: RequestInit): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(path, options);
  } catch (fault) {
    if (isAbort(fault)) throw fault;
    throw new ApiError(0, "ConnectionError", "the server does not answer; is `kinedex explore` still running?");
  }
  if (!response.ok) throw await failure(response);
  return response;
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await (await request(path, { signal })).json()) as T;
}

export async function post<T>(path: string, body: unknown, signal?: AbortSignal): Promise<T> {
  return (await (await request(path, posted(body, signal))).json()) as T;
}

export async function getBytes(path: string, signal?: AbortSignal): Promise<ArrayBuffer> {
  return (await request(path, { signal })).arrayBuffer();
}

export async function getStream(path: string, signal?: AbortSignal): Promise<ReadableStream<Uint8Array>> {
  return (await request(path, { signal })).body ?? new ReadableStream();
}

/** Post a question whose answer takes a while: the server sends lines with the progress first. */
export async function postLines<T>(path: string, body: unknown, onStep: (step: Step) => void, signal?: AbortSignal): Promise<T> {
  const options = posted(body, signal);
  const asked = { ...options, headers: { ...options.headers, accept: "application/x-ndjson" } };
  return lastAnswer(await request(path, asked), onStep);
}

/** Get an answer that takes a while: the server sends lines with the progress first. */
export async function getLines<T>(path: string, onStep: (step: Step) => void, signal?: AbortSignal): Promise<T> {
  return lastAnswer(await request(path, { signal }), onStep);
}

async function lastAnswer<T>(response: Response, onStep: (step: Step) => void): Promise<T> {
  const stopped = new ApiError(0, "ConnectionError", "the server stopped before the answer was there");
  try {
    for await (const text of readLines(response.body ?? new ReadableStream())) {
      const line = JSON.parse(text) as Step & { answer?: T; error?: Fault; status: number };
      if (line.error !== undefined) throw new ApiError(line.status, line.error.type, line.error.message, line.error.remedy);
      if (line.answer !== undefined) return line.answer;
      onStep({ done: line.done, total: line.total });
    }
  } catch (fault) {
    throw fault instanceof ApiError || isAbort(fault) ? fault : stopped;
  }
  throw stopped;
}

export async function postBytes(path: string, body: unknown, signal?: AbortSignal): Promise<ArrayBuffer> {
  return (await request(path, posted(body, signal))).arrayBuffer();
}

function posted(body: unknown, signal?: AbortSignal): RequestInit {
  return { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body), signal };
}
