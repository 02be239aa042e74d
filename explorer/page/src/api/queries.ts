// State of the server as the page holds it. A key begins with its kind: what depends on the version of the store is
// asked again when a newer one can be read ("version"), what depends on labels when labels change ("labels").

import { QueryClient, useQuery } from "@tanstack/react-query";

import { ApiError, get } from "./client";
import type { StoreFacts } from "./types";

export const queries = new QueryClient({
  defaultOptions: {
    queries: {
      staleTime: Infinity,
      gcTime: 60_000,
      refetchOnWindowFocus: false,
      retry: (count, fault) => fault instanceof ApiError && fault.status === 0 && count < 2,
    },
  },
});

export function useStore() {
  return useQuery({
    queryKey: ["version", "store"],
    queryFn: ({ signal }) => get<StoreFacts>("/api/store", signal),
  });
}
