// Texts of the Runs page.

/** Return the parameters of a text with one NAME=VALUE a line, or the first line that is none. */
export function parametersOf(text: string): { values: Record<string, string>; wrong: string | null } {
  const values: Record<string, string> = {};
  for (const line of text.split("\n").map((one) => one.trim())) {
    if (line === "") continue;
    const at = line.indexOf("=");
    if (at < 1) return { values, wrong: line };
    values[line.slice(0, at).trim()] = line.slice(at + 1).trim();
  }
  return { values, wrong: null };
}

/** Return a duration in the unit that suits it. */
export function duration(seconds: number): string {
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const minutes = Math.floor(seconds / 60);
  return minutes < 60 ? `${minutes} min ${Math.round(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export const moment = (text: string | null) => (text ?? "").slice(0, 16).replace("T", " ");

export const reportAddress = (name: string) => `/api/reports/${name.split("/").map(encodeURIComponent).join("/")}`;
