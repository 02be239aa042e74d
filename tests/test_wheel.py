"""A wheel built from the checkout works outside it, with its configuration files."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.pipelines.archives import write_archive

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_an_installed_wheel_brings_its_configs_and_runs_anywhere(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "-q"]
    build = [*pip, "wheel", str(ROOT), "--no-deps", "--no-build-isolation", "-w", str(tmp_path)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("kinedex-*.whl")
    target = tmp_path / "installed"
    install = [*pip, "install", "--no-deps", "--no-index", "--target", str(target), str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    # The libraries come from this environment, kinedex itself from the wheel alone: a PYTHONPATH entry does not
    # follow the link that an editable install leaves in its folder.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(target), sysconfig.get_paths()["purelib"]])}
    # Compiled again in a new place, the same kernels would take most of a minute; one of them stands for all below.
    plain = environment | {"NUMBA_DISABLE_JIT": "1"}
    source = write_archive(tmp_path / "source", {"x_aa_1.amc": 40})

    def run(*words: str, env: dict[str, str] = plain) -> str:
        command = [sys.executable, "-S", *words]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    where = run(
        "-c",
        "import kinedex.catalog.configs as c, kinedex.pipelines as p; print(c.shipped_configs()); print(p.__file__)",
    )
    assert all(line.startswith(str(target)) for line in where.splitlines())
    assert "everything" not in run("-m", "kinedex", "ingest", "store", str(source), "--executor", "serial")
    assert run("-m", "kinedex", "sql", "store", "SELECT name FROM takes", "--format", "csv") == "name\nx_aa_1\n"
    settings = ["--set", f"source={source}", "--set", "evaluate.ground_truth=none"]
    assert "learn_templates" in run("-m", "kinedex", "plan", "annotate", "--store", "store", *settings)
    assert "squat" in run("-m", "kinedex", "search", "store", "example", "--explain")
    kernel = "import numpy as np; from kinedex.ops.bits import count_bits; print(count_bits(np.uint64(7)))"
    assert run("-c", kernel, env=environment) == "3\n"
    assert list((target / "kinedex" / "ops" / "__pycache__").glob("bits.count_bits*.nbi")), (
        "compiled code is kept where it lies"
    )
    for room in ("ops", "catalog", "storage", "pipelines", "configs"):
        shipped = {
            p.relative_to(ROOT) for p in (ROOT / room).rglob("*") if p.is_file() and "__pycache__" not in p.parts
        }
        assert {p for p in shipped if not (target / "kinedex" / p).is_file()} == set()
    assert (target / "kinedex" / "py.typed").is_file()
    ours = {path.name for path in target.iterdir() if not path.name.endswith(".dist-info")}
    assert ours <= {"kinedex", "bin"}, "nothing but kinedex stands in site-packages"
