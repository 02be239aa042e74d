"""Studies of accuracy: programs `python -m studies.NAME`, which `python -m studies` lists.

Speed and memory are the subject of `benchmarks/`. The tables that studies print stand in docs/studies.md,
docs/accuracy.md, docs/keyframe-study.md, docs/quality.md and docs/thesis.md, under the command that printed them.
"""

import os
import sys
from pathlib import Path
from types import TracebackType

from kinedex.ops.errors import KinedexError

BUILD = Path(os.environ.get("KINEDEX_STUDIES") or Path(__file__).resolve().parents[1] / "build" / "studies")
"""The folder of stores and archives that studies make; KINEDEX_STUDIES names another one."""


def _report(kind: type[BaseException], fault: BaseException, trace: TracebackType | None) -> None:
    """Report errors of kinedex, which name their way out, in one message, and others with their traceback."""
    if isinstance(fault, KinedexError):
        print(f"python -m studies: {fault}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, fault, trace)


sys.excepthook = _report
