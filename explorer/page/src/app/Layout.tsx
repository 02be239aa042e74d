import { ActionIcon, Anchor, Badge, Loader, Modal, Table, Text, Title, useComputedColorScheme, useMantineColorScheme } from "@mantine/core";
import { useDisclosure } from "@mantine/hooks";
import { Suspense, useEffect } from "react";
import { Link, Route, Switch, useLocation } from "wouter";

import { useEvents, useJobs, useTrouble } from "../api/events";
import { useStore } from "../api/queries";
import { counted, hours } from "../archive/text";
import { takeName, useParameter } from "./address";
import { Fault, FaultBoundary } from "./Fault";
import { loadPages, PAGES } from "./pages";
import { SameBar } from "./SameBar";
import { keyNames, useShortcuts, useShownShortcuts } from "./shortcuts";

/** Other pages are loaded once the first has had so long to show what it holds. */
const IDLE_MS = 2000;

/** The frame of every page: header, navigation, content, and the bar with the command that does the same. */
export function Layout() {
  useEvents();
  const [location, navigate] = useLocation();
  const [help, { open, close }] = useDisclosure(false);
  const page = PAGES.find((one) => isShown(one.path, location));
  const take = useShownTake();
  useEffect(() => {
    document.title = [take, page?.title, "kinedex"].filter((part) => part != null).join(" · ");
  }, [page, take]);
  useDoubleClickOnce(location);
  useEffect(() => {
    const timer = setTimeout(() => void loadPages(), IDLE_MS);
    return () => clearTimeout(timer);
  }, []);
  useShortcuts("Everywhere", [
    { keys: "?", what: "List the keys", run: open },
    ...PAGES.map((one) => ({ keys: `g ${one.key}`, what: `Go to ${one.title}`, run: () => navigate(one.path) })),
  ]);
  return (
    <div className="shell">
      <a className="skip" href="#content">
        Skip to the content
      </a>
      <Header onHelp={open} />
      <nav className="shell-navigation" aria-label="Pages">
        <ul>
          {PAGES.map((one) => (
            <li key={one.path}>
              <Link href={one.path} aria-current={one === page ? "page" : undefined}>
                {one.title}
              </Link>
            </li>
          ))}
        </ul>
      </nav>
      <main id="content" className="shell-content" tabIndex={-1}>
        <FaultBoundary key={page?.path}>
          <Content />
        </FaultBoundary>
      </main>
      <SameBar />
      <Keys opened={help} close={close} />
    </div>
  );
}

/** The take that the address names, on Take in its path, on Ask and Label as a parameter. */
function useShownTake(): string | null {
  const [named] = useParameter("take");
  return takeName(window.location.pathname) ?? named;
}

const DOUBLE_MS = 700;

/** Let the second press of a double click on a link do nothing on the page that it leads to, where it selects all text. */
function useDoubleClickOnce(location: string): void {
  useEffect(() => {
    const begin = performance.now();
    const hold = (event: MouseEvent) => {
      if (event.detail > 1 && performance.now() - begin < DOUBLE_MS) event.preventDefault();
    };
    window.addEventListener("mousedown", hold, true);
    return () => window.removeEventListener("mousedown", hold, true);
  }, [location]);
}

/** The page of the address; only a store that could never be read stands in its place. */
function Content() {
  const store = useStore();
  if (store.isError && store.data === undefined)
    return (
      <div className="page">
        <Fault fault={store.error} retry={() => window.location.reload()} />
      </div>
    );
  return (
    <Suspense fallback={<Loader m="md" size="sm" aria-label="Loading" />}>
      <Switch>
        {PAGES.map((one) => (
          <Route key={one.path} path={one.pattern} component={one.view} />
        ))}
        <Route component={NoPage} />
      </Switch>
    </Suspense>
  );
}

/** What stands where an address leads nowhere: below a page it was meant to name something there. */
function NoPage() {
  const [location] = useLocation();
  const page = PAGES.find((one) => one.path !== "/" && isShown(one.path, location));
  return (
    <div className="page">
      <Title order={1}>No page has this address</Title>
      <Text>
        {page === undefined ? (
          <><Anchor component={Link} href="/">All takes</Anchor> are under Archive.</>
        ) : (
          <>
            Nothing under {page.title} is named “{lastName(location)}”.{" "}
            <Anchor component={Link} href={page.path}>Open {page.title}</Anchor> to see what there is.
          </>
        )}
      </Text>
    </div>
  );
}

function lastName(location: string): string {
  const name = location.split("/").filter((part) => part !== "").at(-1) ?? "";
  try {
    return decodeURIComponent(name);
  } catch {
    return name; // no address that this page has made
  }
}

function isShown(path: string, location: string): boolean {
  return path === "/" ? location === "/" : location === path || location.startsWith(`${path}/`);
}

function Header({ onHelp }: { onHelp: () => void }) {
  const store = useStore();
  const jobs = useJobs().filter((job) => job.state === "running");
  const trouble = useTrouble();
  const facts = store.data;
  return (
    <header className="shell-header">
      <Text fw={700}>kinedex</Text>
      {facts !== undefined && (
        <Text size="sm" truncate title={facts.path}>
          {facts.name}{" "}
          <span className="muted">
            version {facts.version} · {counted(facts.takes, "take")} · {hours(facts.hours)}
          </span>
        </Text>
      )}
      {facts?.read_only === true && <Badge variant="outline">read only</Badge>}
      <div style={{ flex: 1 }} />
      <div role="status" aria-live="polite">
        {trouble !== "" && (
          <Badge color="red" tt="none" title={trouble}>
            {trouble}
          </Badge>
        )}
        {jobs.map((job) => (
          <Badge key={job.id} variant="light">
            {job.title} {job.share === null ? "" : `${Math.floor(100 * job.share)} %`}
          </Badge>
        ))}
      </div>
      <ThemeSwitch />
      <ActionIcon variant="default" aria-label="List the keys" title="Keys (?)" onClick={onHelp}>
        ?
      </ActionIcon>
    </header>
  );
}

function ThemeSwitch() {
  const { setColorScheme } = useMantineColorScheme();
  const scheme = useComputedColorScheme("light", { getInitialValueInEffect: false });
  const other = scheme === "dark" ? "light" : "dark";
  return (
    <ActionIcon
      variant="default"
      aria-label={`Use the ${other} theme`}
      title={`Use the ${other} theme`}
      onClick={() => setColorScheme(other)}
    >
      {scheme === "dark" ? "☀" : "☾"}
    </ActionIcon>
  );
}

function Keys({ opened, close }: { opened: boolean; close: () => void }) {
  const groups = useShownShortcuts();
  return (
    <Modal opened={opened} onClose={close} title="Keys" size="lg">
      {groups.map((group) => (
        <section key={group.title}>
          <Text fw={600} mt="sm">
            {group.title}
          </Text>
          <Table verticalSpacing={3}>
            <Table.Tbody>
              {group.shortcuts.map((one) => (
                <Table.Tr key={one.keys}>
                  <Table.Td w={140}>
                    <kbd>{keyNames(one.keys)}</kbd>
                  </Table.Td>
                  <Table.Td>{one.what}</Table.Td>
                </Table.Tr>
              ))}
            </Table.Tbody>
          </Table>
        </section>
      ))}
    </Modal>
  );
}
