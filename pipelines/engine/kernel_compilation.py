"""`python -m kinedex.pipelines.engine.kernel_compilation`: compile listed kernels on all cores before they are needed.

numba compiles a kernel on one core when it is first called. A set-up or a demo compiles kernels in the background
instead. Kernels that are in the cache already are not compiled again.
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Sequence

from kinedex.ops.kernel_list import compile_call, listed_calls
from kinedex.pipelines.engine.executors import begin_worker, cores, ctrl_c_blocked


class KernelCompilation:
    """Processes that compile the listed kernels in the background.

    The processes end when their parent process ends.

    Parameters
    ----------
    workers : int or None, optional
        Number of processes; by default one per core.
    """

    def __init__(self, workers: int | None = None) -> None:
        groups = balanced(listed_calls(), workers or cores())
        context = multiprocessing.get_context("spawn")
        self._processes = [context.Process(target=_compile, args=(group,)) for group in groups]
        with ctrl_c_blocked():
            for process in self._processes:
                process.start()

    @property
    def is_done(self) -> bool:
        """True once all processes have ended."""
        return not any(process.is_alive() for process in self._processes)

    def wait(self) -> None:
        """Wait for the processes; kernels that they could not compile are compiled when they are first called."""
        for process in self._processes:
            process.join()


def balanced(calls: Sequence[str], parts: int) -> list[list[str]]:
    """Divide kernel calls among processes; kernels of one file stay together, because such kernels call each other.

    Parameters
    ----------
    calls : sequence of str
        Lines of the list of kernels.
    parts : int
        Number of processes.

    Returns
    -------
    list of list of str
        At most `parts` groups, none of them empty, each in the order of the list.
    """
    files: dict[str, list[str]] = {}
    for call in calls:
        files.setdefault(call.partition("(")[0].rpartition(".")[0], []).append(call)
    groups: list[list[str]] = [[] for _ in range(parts)]
    for group in files.values():
        min(groups, key=len).extend(group)
    return [group for group in groups if group]


def _compile(calls: Sequence[str]) -> None:
    """Compile kernels in a worker process, without garbage collection, as most objects that numba makes stay alive."""
    import gc

    begin_worker()
    gc.disable()
    for call in calls:
        try:
            compile_call(call)
        except ValueError:  # a stale entry of the list is skipped; its kernel is compiled when called
            continue


def main() -> int:
    """Compile the listed kernels and wait for them."""
    KernelCompilation().wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
