import { expect, test, vi } from "vitest";

vi.stubGlobal("window", { addEventListener: () => undefined });
const { keysOf } = await import("./shortcuts");

test("Ctrl and ⌘ are one modifier", () => {
  expect(keysOf({ key: "Z", ctrlKey: true, metaKey: false, altKey: false })).toBe("mod+z");
  expect(keysOf({ key: "z", ctrlKey: false, metaKey: true, altKey: false })).toBe("mod+z");
  expect(keysOf({ key: "?", ctrlKey: false, metaKey: false, altKey: false })).toBe("?");
});
