"""Studies of accuracy: programs `python -m studies.NAME`, which `python -m studies` lists.

Speed and memory are the subject of `benchmarks/`. The tables that studies print stand in docs/studies.md,
docs/accuracy.md, docs/keyframe-study.md, docs/quality.md and docs/thesis.md, under the command that printed them.
"""

from pathlib import Path

BUILD = Path(__file__).resolve().parents[1] / "build" / "studies"
"""The folder of stores and archives that studies make."""
