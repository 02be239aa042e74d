import react from "@vitejs/plugin-react";
import { defineConfig } from "vite";

// The page is served by the Python server alone, under a policy without inline scripts.
export default defineConfig({
  plugins: [react()],
  build: {
    outDir: "../built",
    emptyOutDir: true,
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0,
    target: "es2022",
    chunkSizeWarningLimit: 900,
    rolldownOptions: { checks: { bundlerTimings: false } },
  },
  test: { environment: "node", include: ["src/**/*.test.ts"] },
} as Parameters<typeof defineConfig>[0]);
