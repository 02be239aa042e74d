"""Record what numba compiles and loads, where `KINEDEX_COMPILATIONS` names a folder.

This is on the path of what `benchmarks.compilation` runs, and nowhere else. Each process writes a file of JSON lines,
one for each kernel that Python code requests, and one for each compilation.
"""

import importlib.abc
import importlib.util
import json
import os
import sys
import time

FOLDER = os.environ.get("KINEDEX_COMPILATIONS")


def _record(**event):
    with open(os.path.join(FOLDER, f"{os.getpid()}.jsonl"), "a", encoding="utf-8") as file:
        file.write(json.dumps(event) + "\n")


def _watch():
    """Record requests that no other kernel makes, and every compilation with its own processor time."""
    from numba.core.dispatcher import Dispatcher, _FunctionCompiler

    request, compilation = Dispatcher.compile, _FunctionCompiler.compile
    depth, inner = [0], []

    def compile_requested(self, signature):
        depth[0] += 1
        begun = time.monotonic()
        missed = sum(self._cache_misses.values())
        try:
            return request(self, signature)
        finally:
            depth[0] -= 1
            if not depth[0] and self.py_func.__module__.startswith("kinedex."):
                from kinedex.ops.kernel_list import call_text

                try:
                    call = call_text(self.py_func, signature)
                except ValueError as fault:
                    call = str(fault)
                compiled = sum(self._cache_misses.values()) > missed
                _record(request=call, compiled=compiled, seconds=time.monotonic() - begun)

    def compile_timed(self, args, return_type):
        inner.append(0.0)
        begun = time.thread_time()
        try:
            return compilation(self, args, return_type)
        finally:
            took = time.thread_time() - begun
            within = inner.pop()
            if inner:
                inner[-1] += took
            kernel = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
            _record(kernel=kernel, types=str(args), cpu=took - within)

    Dispatcher.compile, _FunctionCompiler.compile = compile_requested, compile_timed


class _AfterNumba(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        """Watch numba once it has been imported, and import nothing for processes that do without it."""
        if name != "numba":
            return None
        sys.meta_path.remove(self)
        found = importlib.util.find_spec(name)
        run = found.loader.exec_module

        def run_and_watch(module):
            run(module)
            _watch()

        found.loader.exec_module = run_and_watch
        return found


if FOLDER:
    sys.meta_path.insert(0, _AfterNumba())
