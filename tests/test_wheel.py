"""A wheel built from the source distribution works outside the checkout, beside modules of the user's own."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.pipelines.archives import write_archive

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("ops", "catalog", "storage", "pipelines", "reports", "explorer", "configs")
PAGE = ROOT / "explorer" / "page"
OWN = ("library", "console", "commands")
"""Folders of `kinedex/` that are no links."""

BUILT = PAGE.parent / "built"
STAND_IN = "WHOSE = 'the ops of PyPI'\n"

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Installed:
    """A folder of packages: kinedex from a wheel, and a stand-in for the distribution `ops` of PyPI."""

    target: Path
    sdist: Path
    wheel: Path

    @property
    def environment(self) -> dict[str, str]:
        """The libraries come from this environment, kinedex itself from the wheel alone.

        Kernels are not compiled: in a new place that would take most of a minute.
        """
        path = os.pathsep.join([str(self.target), sysconfig.get_paths()["purelib"]])
        return os.environ | {"PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"}


def execute(command: list[str], folder: Path, env: dict[str, str] | None = None) -> str:
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("wheel")
    execute([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(folder)], ROOT)
    (sdist,) = folder.glob("kinedex-*.tar.gz")
    pip = [sys.executable, "-m", "pip", "-q"]
    ops = folder / "stand-in"
    (ops / "ops").mkdir(parents=True)
    (ops / "ops" / "__init__.py").write_text(STAND_IN)
    (ops / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["hatchling"]\nbuild-backend = "hatchling.build"\n'
        '[project]\nname = "ops"\nversion = "1.0"\n'
    )
    for source in (sdist, ops):
        execute([*pip, "wheel", str(source), "--no-deps", "--no-build-isolation", "-w", str(folder)], folder)
    wheels = sorted(folder.glob("*.whl"))
    target = folder / "installed"
    execute(
        [*pip, "install", "--no-compile", "--no-deps", "--no-index", "--target", str(target), *map(str, wheels)], folder
    )
    return Installed(target, sdist, wheels[0])


def build_copy(folder: Path, umask: int, zone: str, seconds: int) -> dict[str, str]:
    """Build wheel and sdist of a copy of the checkout with other rights and times, and return their checksums."""
    unneeded = shutil.ignore_patterns(
        ".git", ".venv", "build", "dist", "__pycache__", "shared", "tests", "studies", "node_modules"
    )
    copy, out = folder / "a copy", folder / "out"
    shutil.copytree(ROOT, copy, symlinks=True, ignore=unneeded)
    for path in copy.rglob("*"):
        if not path.is_symlink():
            path.chmod((0o777 if path.is_dir() else 0o666) & ~umask)
            os.utime(path, (seconds, seconds))
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
    (epoch,) = re.findall(r"^EPOCH +:= (\d+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    env = os.environ | {"TZ": zone, "SOURCE_DATE_EPOCH": epoch}
    done = subprocess.run(command, cwd=copy, env=env, umask=umask, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.iterdir()}


@pytest.mark.skipif(os.name == "nt", reason="there are no such rights on Windows")
def test_two_builds_have_the_same_bytes(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "another place").mkdir()
    first = build_copy(tmp_path / "one", 0o022, "UTC", 1_700_000_000)
    assert len(first) == 2
    assert build_copy(tmp_path / "another place", 0o077, "Asia/Tokyo", 1_800_000_000) == first


@pytest.fixture
def beside_own_modules(tmp_path: Path) -> Path:
    """A user's folder, whose modules have the names of the rooms."""
    for name in ("ops", "pipelines"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("WHOSE = 'mine'\n")
    for name in ("storage", "catalog", "configs"):
        (tmp_path / f"{name}.py").write_text("WHOSE = 'mine'\n")
    return tmp_path


def test_sdist_and_wheel_hold_plain_folders_with_every_file(installed: Installed) -> None:
    shipped = {
        f"kinedex/{path.relative_to(folder)}"
        for folder in (ROOT, ROOT / "kinedex")
        for room in (ROOMS if folder == ROOT else OWN)
        for path in (folder / room).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and PAGE not in path.parents
    } | {"kinedex/__init__.py", "kinedex/__main__.py", "kinedex/py.typed"}
    with tarfile.open(installed.sdist) as packed:
        members = packed.getmembers()
    assert not [member.name for member in members if member.issym() or member.islnk()]
    assert shipped - {member.name.split("/", 1)[1] for member in members} == set()
    with zipfile.ZipFile(installed.wheel) as packed_wheel:
        names = {name for name in packed_wheel.namelist() if ".dist-info/" not in name}
    assert names == shipped, "the wheel holds what the checkout has, and nothing beside kinedex"


def test_the_page_of_the_explorer_is_packed_without_what_built_it(installed: Installed) -> None:
    with tarfile.open(installed.sdist) as packed:
        sources = {name.split("/explorer/", 1)[1] for name in packed.getnames() if "/explorer/" in name}
    assert {"page/package-lock.json", "page/src/main.tsx"} <= sources, "the source distribution can build the page"
    assert not [name for name in sources if "node_modules" in name]
    if not (BUILT / "index.html").is_file():
        missing = "the page of the explorer has not been built (make page)"
        if os.environ.get("KINEDEX_BROWSER") == "required":
            pytest.fail(missing)
        pytest.skip(missing)
    assert "built/index.html" in sources, "the source distribution installs without node"
    code = "from kinedex.explorer.application import require_page; require_page()"
    execute([sys.executable, "-c", code], installed.target.parent, installed.environment)
    page = installed.target / "kinedex" / "explorer" / "built"
    scripts = re.findall(r'(?:src|href)="/([^"]+)"', (page / "index.html").read_text(encoding="utf-8"))
    assert scripts
    assert all((page / name).is_file() for name in scripts)
    assert sum(len(gzip.compress(path.read_bytes())) for path in page.rglob("*") if path.is_file()) < 2_000_000


SEVERAL = """
import json
import sys

from kinedex.commands.cli import app

for words in json.loads(sys.argv[1]):
    app(words, prog_name="kinedex", standalone_mode=False)
    print("END", flush=True)
"""


def test_an_installed_wheel_brings_its_configs_and_runs_anywhere(installed: Installed, tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_aa_1.amc": 40})

    def run(*words: str, env: dict[str, str] = installed.environment) -> str:
        return execute([sys.executable, "-S", *words], tmp_path, env)

    where = run(
        "-c",
        "import kinedex.catalog.configs as c, kinedex.pipelines as p; print(c.shipped_configs()); print(p.__file__)",
    )
    assert all(line.startswith(str(installed.target)) for line in where.splitlines())
    assert "everything" not in run("-m", "kinedex", "ingest", "store", str(source), "--executor", "serial")
    settings = ["--set", f"source={source}", "--set", "evaluate.ground_truth=none"]
    commands = [
        ["sql", "store", "SELECT name FROM takes", "--format", "csv"],
        ["plan", "annotate", "--store", "store", *settings],
        ["search", "store", "example", "--explain"],
    ]
    rows, plan, explained = run("-c", SEVERAL, json.dumps(commands)).split("END\n")[:3]
    assert rows == "name\nx_aa_1\n"
    assert "learn_templates" in plan
    assert "squat" in explained
    kernel = "import numpy as np; from kinedex.ops.bits import count_bits; print(count_bits(np.uint64(7)))"
    compiling = {name: value for name, value in installed.environment.items() if name != "NUMBA_DISABLE_JIT"}
    assert run("-c", kernel, env=compiling) == "3\n"
    assert list((installed.target / "kinedex" / "ops" / "__pycache__").glob("bits.count_bits*.nbi")), (
        "compiled code is kept where it lies"
    )


def test_the_distribution_ops_of_others_stays_whole(installed: Installed, tmp_path: Path) -> None:
    assert (installed.target / "ops" / "__init__.py").read_text() == STAND_IN
    ours = {path.name for path in installed.target.iterdir() if not path.name.endswith(".dist-info")}
    assert ours <= {"kinedex", "bin", "ops"}, "nothing but kinedex stands in site-packages"
    code = "import kinedex, ops, kinedex.ops.words as words; print(ops.WHOSE); print(words.__file__)"
    whose, file = execute([sys.executable, "-c", code], tmp_path, installed.environment).splitlines()
    assert whose == "the ops of PyPI"
    assert file.startswith(str(installed.target / "kinedex"))


SCRIPT = """
import sys

import kinedex
import storage, catalog, ops, pipelines, configs

if __name__ == "__main__":
    assert {one.WHOSE for one in (storage, catalog, ops, pipelines, configs)} == {"mine"}
    own = {name: sys.modules.pop(name) for name in ("storage", "catalog", "ops", "pipelines", "configs")}
    settings = {"source": "archive", "evaluate.ground_truth": "none"}
    kinedex.run_pipeline("annotate", "store", settings, executor="processes", workers=2)
    assert not own.keys() & sys.modules.keys(), "a room was imported by its bare name"
    print(len(kinedex.open_store("store")), kinedex.__file__)
"""


def test_a_script_runs_the_main_job_beside_modules_named_like_the_rooms(
    installed: Installed, beside_own_modules: Path
) -> None:
    # few and short, as kernels are not compiled here
    clips = [f"{name}/x_{actor}_{name}_1_120.amc" for name in ("squat1Reps", "kickLeft1Reps") for actor in ("aa", "bb")]
    files = {f"clips/{clip}": 48 for clip in clips} | {"takes/x_aa_take01.amc": 60}
    write_archive(beside_own_modules / "archive", files)
    (beside_own_modules / "script.py").write_text(SCRIPT)
    takes, file = execute([sys.executable, "script.py"], beside_own_modules, installed.environment).split()
    assert int(takes) == len(files)
    assert file.startswith(str(installed.target))


def test_a_notebook_runs_beside_modules_named_like_the_rooms(installed: Installed, beside_own_modules: Path) -> None:
    code = (
        "import kinedex, storage\n"
        "print(storage.WHOSE, kinedex.load_feature_set().name, kinedex.Query([{'on': ['rknee_bent']}]))"
    )
    cell = {"cell_type": "code", "id": "one", "metadata": {}, "execution_count": None, "outputs": [], "source": code}
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    notebook = {"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    (beside_own_modules / "cell.ipynb").write_text(json.dumps(notebook))
    convert = ["-m", "jupyter", "nbconvert", "--to", "markdown", "--stdout", "--execute", "cell.ipynb"]
    page = execute([sys.executable, *convert], beside_own_modules, installed.environment)
    assert "mine body40 <Query 'query' of 1 keyframes>" in page


def test_the_command_runs_beside_modules_named_like_the_rooms(installed: Installed, beside_own_modules: Path) -> None:
    command = installed.target / "bin" / ("kinedex.exe" if os.name == "nt" else "kinedex")
    assert "takes" in execute([str(command), "--help"], beside_own_modules, installed.environment)
    version = execute([str(command), "version"], beside_own_modules, installed.environment)
    assert str(installed.target / "kinedex") in version
