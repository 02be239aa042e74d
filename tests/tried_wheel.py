"""Try an installed wheel from outside the checkout: `python -m tests.tried_wheel ENVIRONMENT STORE` (`make wheel`).

The command `kinedex` of the environment opens the store in its explorer, which a real browser looks at, and the
notebook of the docs runs in the environment's Python. Nothing of the checkout is on the path of either.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WAIT_MS = 60_000
NOTEBOOK_SECONDS = 600


def command_of(environment: Path, name: str) -> str:
    """Return the path of a command that is installed in an environment."""
    return str(environment / ("Scripts" if os.name == "nt" else "bin") / name)


def outside() -> dict[str, str]:
    """Return the variables of this process without those that would bring the checkout into another Python."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}


@contextmanager
def served(environment: Path, store: Path) -> Iterator[str]:
    """Serve a store by the environment's own command; give the address with its token."""
    command = [command_of(environment, "kinedex"), "explore", str(store), "--no-browser", "--port", "0"]
    process = subprocess.Popen(
        command, cwd=store.parent, env=outside(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        assert process.stdout is not None
        seen = ""
        for line in process.stdout:
            seen += line
            if found := re.search(r"http://\S+\?token=\S+", line):
                yield found.group(0)
                return
        sys.exit(f"the installed explorer did not start:\n{seen}")
    finally:
        process.terminate()
        process.wait(WAIT_MS / 1000)


def look_at_explorer(address: str, takes: int) -> None:
    """Open the explorer in a browser: its table counts the takes, and a take that is clicked plays."""
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"the page cannot be tried without {', '.join(BROWSERS)}: apt-get install chromium")
    expect.set_options(timeout=WAIT_MS)
    faults: list[str] = []
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=browser, args=["--no-sandbox", "--enable-unsafe-swiftshader"], timeout=WAIT_MS
        )
        page = chromium.new_page()
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(address)
        expect(page.locator(".amount [role=status]")).to_have_text(re.compile(f"^{takes:,} takes"))
        page.get_by_role("gridcell", name=re.compile("_take01$")).first.dblclick()
        expect(page.get_by_role("button", name=re.compile("^(Play|Pause)"))).to_be_visible()
        chromium.close()
    if faults:
        sys.exit("the page of the installed explorer reports errors:\n" + "\n".join(faults))


def run_notebook(environment: Path, folder: Path) -> None:
    """Run the notebook of the docs by the environment's Python, beside the archive that it asks for.

    What runs notebooks comes into the environment now, so that everything before did without it.
    """
    folder.mkdir(parents=True)
    install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes", "-r"]
    locked = [command_of(environment, "python"), *install, str(ROOT / "requirements-dev.lock")]
    subprocess.run(locked, env=outside(), check=True, timeout=NOTEBOOK_SECONDS)
    synth = [command_of(environment, "kinedex"), "synth", "archive", "--minutes", "3", "--actors", "2"]
    subprocess.run(synth, cwd=folder, env=outside(), check=True, timeout=NOTEBOOK_SECONDS)
    shutil.copy(ROOT / "docs" / "ten-tasks.ipynb", folder)
    convert = ["-m", "jupyter", "nbconvert", "--to", "notebook", "--execute", "--output", "ran.ipynb"]
    limits = [f"--ExecutePreprocessor.timeout={NOTEBOOK_SECONDS}", "ten-tasks.ipynb"]
    subprocess.run(
        [command_of(environment, "python"), *convert, *limits],
        cwd=folder, env=outside() | {"JUPYTER_CONFIG_DIR": str(folder), "IPYTHONDIR": str(folder)},
        check=True, timeout=NOTEBOOK_SECONDS,
    )  # fmt: skip
    cells = json.loads((folder / "ran.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    if not all(cell["execution_count"] for cell in code):
        sys.exit("a cell of the notebook did not run")


def main(words: list[str]) -> None:
    """Try the explorer and the notebook of an installed wheel."""
    parser = argparse.ArgumentParser(prog="python -m tests.tried_wheel", description=__doc__.splitlines()[0])
    parser.add_argument("environment", type=Path, help="the environment that the wheel is installed in")
    parser.add_argument("store", type=Path, help="a store that its `kinedex demo` has made")
    given = parser.parse_args(words)
    environment, store = given.environment.resolve(), given.store.resolve()
    question = [command_of(environment, "kinedex"), "sql", str(store), "SELECT count(*) FROM takes", "--format", "csv"]
    counted = subprocess.run(
        question, cwd=store.parent, env=outside(), capture_output=True, text=True, check=True, timeout=WAIT_MS / 1000
    ).stdout
    takes = int(counted.split()[-1])
    with served(environment, store) as address:
        look_at_explorer(address, takes)
    print(f"the installed explorer shows {takes:,} takes and plays one")
    run_notebook(environment, environment / "notebook")
    print("the notebook of the docs runs to its end in the installed kinedex")


if __name__ == "__main__":
    main(sys.argv[1:])
