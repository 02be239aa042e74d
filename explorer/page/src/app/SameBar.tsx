import { Button, CopyButton, SegmentedControl } from "@mantine/core";
import { useLocalStorage } from "@mantine/hooks";

import { useShownSame } from "./same";

/** The bar that shows the command or the Python lines which do the same as the page. */
export function SameBar() {
  const same = useShownSame();
  const [language, setLanguage] = useLocalStorage<"command" | "python">({
    key: "kinedex-same",
    defaultValue: "command",
    getInitialValueInEffect: false,
  });
  const text = same[language] ?? same.command ?? same.python ?? "";
  return (
    <footer className="shell-same" aria-label="The same by command">
      <SegmentedControl
        size="xs"
        aria-label="Language of the line"
        value={language}
        onChange={(value) => setLanguage(value as "command" | "python")}
        data={[
          { value: "command", label: "Shell" },
          { value: "python", label: "Python" },
        ]}
      />
      <code title={text}>{text.replaceAll("\n", "; ")}</code>
      <CopyButton value={text}>
        {({ copied, copy }) => (
          <Button size="compact-xs" variant="default" onClick={copy} disabled={text === ""}>
            {copied ? "Copied" : "Copy"}
          </Button>
        )}
      </CopyButton>
    </footer>
  );
}
