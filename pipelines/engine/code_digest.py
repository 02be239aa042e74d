"""Digests of code: a hash of the definitions that a function or class can reach, for fingerprints of its results.

A digest follows names. It starts at a definition and reads its syntax tree. It goes on with the definitions of all
names in this tree, including names that are imported from other modules of kinedex or of a plugin. A class counts with
all of its methods. Names in annotations of functions are followed as well, because they tell the classes of the objects
whose methods are called. The annotations themselves do not count, nor do docstrings and comments.

Consequently, the digest of a stage covers the protocols that the stage names (`Executor`, `Display`), but not the
classes that implement these protocols, because only the runner names these classes.

Where names cannot be followed, larger parts count. A module counts as a whole if it is used as a value, or if an
attribute of it is used that it does not define. Statements of imported modules that are not plain definitions count as
well. Code that is imported by a computed name must be declared: a string "package.module:name" is followed like a name.
Tables of built-in parts consist of such strings, and need no other declaration. Plugins count where they are used
(`part_digest`).
"""

from __future__ import annotations

import ast
import gc
import hashlib
import importlib.util
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from kinedex.catalog.plugins import Plugins

PACKAGE = "kinedex"

ROOT = Path(__file__).resolve().parents[2]
"""The folder that contains the folders of `ROOMS`: the checkout, or the installed package."""

ROOMS = ("ops", "catalog", "storage", "pipelines", "reports", "explorer", "library", "console", "commands")
"""The folders of the package; in a checkout the last three lie in `kinedex/`, and the others beside it."""

WHOLE, EFFECTS = "", "*"
"""Names in a `Place`: for a whole module, and for its statements other than definitions, which run on import."""

_DECLARED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+:[A-Za-z_]\w*")
_KNOWN = Path(__file__).resolve().parent / "__pycache__" / "code_digest.json"

Place = tuple[str, str]
"""A module, and a name that it defines, or `WHOLE` or `EFFECTS`."""


def code_digest(*roots: Callable[..., object] | type | str) -> str:
    """Return a hash of the code that functions or classes can run.

    Parameters
    ----------
    *roots : functions, classes, or texts "module:name"
                The definitions to start from.

    Returns
    -------
    str
        Sixteen hexadecimal digits.
    """
    return _digest(tuple(sorted(_place(root) for root in roots)))


def part_digest(parts: Plugins[Any], name: str) -> str:
    """Return a hash of a plugin's code, and of its distribution's name and version; empty for a built-in part.

    A built-in part needs no hash here, because the digest of the code that uses the table of parts covers it.
    """
    distribution = parts.distribution(name)
    return plugin_digest(distribution, parts.place(name)) if distribution else ""


def plugin_digest(distribution: str, root: Callable[..., object] | type | str) -> str:
    """Return a hash of the code of a plugin, and of its distribution's name and version."""
    return hashlib.sha256(f"{distribution} {code_digest(root)}".encode()).hexdigest()[:16]


def _place(root: Callable[..., object] | type | str) -> Place:
    if isinstance(root, str):
        module, _, name = root.partition(":")
        return module, name.partition(".")[0]
    return root.__module__, root.__qualname__.split(".")[0]


@lru_cache(maxsize=256)
def _digest(roots: tuple[Place, ...]) -> str:
    if any(module.partition(".")[0] != PACKAGE for module, _ in roots):
        return Sources().digest(roots)
    key = " ".join(":".join(place) for place in roots)
    known = _known_digests()
    if key not in known:
        digest = Sources().digest(roots)
        known = _known_digests() | {key: digest}  # including those that other processes have added meanwhile
        other = _KNOWN.with_name(f"{_KNOWN.name}.{os.getpid()}")
        with suppress(OSError):  # a read-only installation has no cache, so that each process computes digests
            _KNOWN.parent.mkdir(exist_ok=True)
            other.write_text(json.dumps(known), encoding="utf-8")
            other.replace(_KNOWN)
    return known[key]


@contextmanager
def _collector_disabled() -> Iterator[None]:
    """Disable the garbage collector, which would spend half of the time on syntax trees without freeing anything."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _known_digests() -> dict[str, str]:
    """Return the cached digests by their roots; none if a file of the package has changed since they were written."""
    code = _code_state()
    with suppress(OSError, ValueError):
        known = json.loads(_KNOWN.read_text(encoding="utf-8"))
        if isinstance(known, dict) and known.get("code") == code:
            return known
    return {"code": code}


@lru_cache(maxsize=1)
def _code_state() -> str:
    """Return a hash of Python's version, and of times and sizes of the Python files in the folders of `ROOMS`."""
    files = sorted(file for room in ROOMS for file in _python_files(_folder(ROOT, room)))
    stamps = json.dumps([(str(file), *_stamp(file)) for file in files])
    return hashlib.sha256(f"{sys.version_info} {stamps}".encode()).hexdigest()


def _folder(root: Path, room: str) -> Path:
    """Return the path of one of `ROOMS`, or of a folder below it, in a checkout or in the installed package."""
    beside, inside = root / room, root / PACKAGE / room
    return inside if not beside.exists() and inside.exists() else beside


def _python_files(folder: Path) -> Iterator[Path]:
    """Yield the Python files below a folder, skipping the explorer's web page, which has many other files."""
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if name not in ("page", "built", "__pycache__")]
        yield from (Path(place, name) for name in files if name.endswith(".py"))


@dataclass
class Code:
    """The content of one definition, apart from docstrings, comments and annotations of functions.

    Attributes
    ----------
    text : str
        The hashes of the syntax trees of its statements, joined to one text.
    names : set of str
        Names and chains of attributes on names, such as "np.zeros", including those in annotations.
    imports : dict of str to Place
        The names that imports inside the definition bind, with the places that they stand for.
    declared : set of Place
        The places that strings of the form "module:name" name.
    """

    text: str = ""
    names: set[str] = field(default_factory=set)
    imports: dict[str, Place] = field(default_factory=dict)
    declared: set[Place] = field(default_factory=set)


def _read(package: str, statements: Iterable[ast.stmt]) -> Code:
    code = Code()
    for statement in statements:
        code.names.update(_chains(statement))
        for node in ast.walk(statement):
            match node:
                case ast.Constant(value=str(text)) if _DECLARED.fullmatch(text):
                    code.declared.add(_place(text))
                case ast.Import() | ast.ImportFrom():
                    code.imports |= _bound(node, package)
                case ast.arg():
                    node.annotation = None
                case ast.FunctionDef() | ast.AsyncFunctionDef():
                    node.returns = None
            if isinstance(body := getattr(node, "body", None), list):
                node.body = [one for one in body if not _is_text(one)]  # type: ignore[attr-defined]
        code.text += hashlib.sha256(ast.dump(statement).encode("utf-8", "backslashreplace")).hexdigest()
    return code


def _chains(node: ast.AST) -> Iterator[str]:
    """Yield the longest chains of attributes on names in a syntax tree, including those in quoted annotations."""
    waiting = [node]
    while waiting:
        one = waiting.pop()
        chain = _chain(one)
        if chain is not None:
            yield chain
            continue
        quoted = [getattr(one, part, None) for part in ("annotation", "returns")]
        for text in quoted:
            if isinstance(text, ast.Constant) and isinstance(text.value, str):
                with suppress(SyntaxError):
                    waiting.append(ast.parse(text.value, mode="eval").body)
        waiting += ast.iter_child_nodes(one)


def _chain(node: ast.AST) -> str | None:
    """Return a name with attributes as a text such as "a.b.c"; None for attributes of any other expression."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        before = _chain(node.value)
        return None if before is None else f"{before}.{node.attr}"
    return None


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _bound(node: ast.Import | ast.ImportFrom, package: str) -> dict[str, Place]:
    """Return the names that an import binds, with the places of the definitions; "*" denotes all names of a module."""
    if isinstance(node, ast.Import):
        return {
            one.asname or one.name.partition(".")[0]: (one.name if one.asname else one.name.partition(".")[0], WHOLE)
            for one in node.names
        }
    base = node.module or ""
    if node.level:
        above = package.split(".")[: len(package.split(".")) - node.level + 1]
        base = ".".join([*above, base] if base else above)
    return {one.asname or one.name: (base, WHOLE if one.name == "*" else one.name) for one in node.names}


class Module:
    """One module of kinedex or of a plugin: its definitions, its imports, and its other statements.

    Attributes
    ----------
    name : str
        The name that it is imported by.
    definitions : dict of str to list of ast.stmt
        The statements that define each name.
    imports : dict of str to Place
        The names that imports bind, including those for type checkers only.
    imported : list of str
        The modules that are imported when this module is.
    effects : list of ast.stmt
        The statements other than definitions, which run on import.
    registered : list of str
        The definitions with a decorator of the module itself or of kinedex, which can register them on import.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        self.definitions: dict[str, list[ast.stmt]] = {}
        self.imports: dict[str, Place] = {}
        self.imported: list[str] = [name.rpartition(".")[0]]
        self.effects: list[ast.stmt] = []
        self._codes: dict[str, Code] = {}
        for statement in ast.parse(path.read_bytes()).body:
            self._add(statement)
        self.registered = [name for name, own in self.definitions.items() if any(map(self._registers, own))]

    def _add(self, statement: ast.stmt) -> None:
        match statement:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                self.definitions.setdefault(name, []).append(statement)
            case ast.Assign(targets=targets) if names := _target_names(targets):
                for name in names:
                    self.definitions.setdefault(name, []).append(statement)
            case ast.AnnAssign(target=ast.Name(id=name)):
                self.definitions.setdefault(name, []).append(statement)
            case ast.AugAssign(target=ast.Name(id=name)) if name in self.definitions:
                self.definitions[name].append(statement)
            case ast.If(test=test) if ast.unparse(test) == "__name__ == '__main__'":
                pass
            case ast.If(test=test) if ast.unparse(test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
                self._add_imports(statement, run=False)
            case ast.Import() | ast.ImportFrom():
                self._add_imports(statement)
            case _ if not _is_text(statement):
                self.effects.append(statement)
                self._add_imports(statement)

    def _add_imports(self, statement: ast.stmt, *, run: bool = True) -> None:
        for node in ast.walk(statement):
            if isinstance(node, ast.Import | ast.ImportFrom):
                bound = _bound(node, self.package)
                self.imports |= bound
                if run:
                    names = [one.name for one in node.names] if isinstance(node, ast.Import) else _modules(bound)
                    self.imported += names

    def _registers(self, statement: ast.stmt) -> bool:
        for decorator in getattr(statement, "decorator_list", ()):
            function = decorator.func if isinstance(decorator, ast.Call) else decorator
            head = (_chain(function) or "").partition(".")[0]
            if head in self.definitions or self.imports.get(head, ("", ""))[0].partition(".")[0] == PACKAGE:
                return True
        return False

    def code(self, name: str) -> Code:
        """Return the content of a definition, or of all statements that run on import if the name is `EFFECTS`."""
        if name not in self._codes:
            self._codes[name] = _read(self.package, self.effects if name == EFFECTS else self.definitions[name])
        return self._codes[name]


def _modules(bound: dict[str, Place]) -> list[str]:
    """Return the modules that the names of a from-import may have imported."""
    return [name for base, part in bound.values() for name in ([base, f"{base}.{part}"] if part else [base])]


def _target_names(targets: list[ast.expr]) -> list[str]:
    names: list[str] = []
    for target in targets:
        parts = target.elts if isinstance(target, ast.Tuple) else [target]
        if not all(isinstance(part, ast.Name) for part in parts):
            return []
        names += [part.id for part in parts if isinstance(part, ast.Name)]
    return names


class Sources:
    """The modules of kinedex and of plugins, from which digests are computed.

    Parameters
    ----------
    root : Path, optional
        The folder that contains the folders of `ROOMS`; by default that of the running program.
    """

    def __init__(self, root: Path = ROOT) -> None:
        self._root = root
        self._packages = {PACKAGE}
        self._modules: dict[str, Module | None] = {}

    def digest(self, roots: Iterable[Place]) -> str:
        """Return a hash of all definitions that can be reached from the given places, as 16 hexadecimal digits."""
        hasher = hashlib.sha256()
        for (module, name), text in sorted(self.reached(roots).items()):
            hasher.update(f"{module}:{name}={text}\n".encode())
        return hasher.hexdigest()[:16]

    @_collector_disabled()
    def reached(self, roots: Iterable[Place]) -> dict[Place, str]:
        """Return all definitions that can be reached from the given places, with the hash of each."""
        waiting: list[Place | None] = []
        for root in roots:
            self._packages.add(root[0].partition(".")[0])
            waiting.append(self._at(root))
        seen: set[Place] = set()
        found: dict[Place, str] = {}
        while waiting:
            place = waiting.pop()
            module = None if place is None or place in seen else self.module(place[0])
            if place is None or module is None:
                continue
            seen.add(place)
            waiting.append((module.name, EFFECTS))
            if place[1] == WHOLE:
                found[place] = ""
                waiting += [(module.name, name) for name in module.definitions]
                continue
            code = module.code(place[1])
            if code.text:
                found[place] = code.text
            if place[1] == EFFECTS:
                waiting += [(module.name, name) for name in module.registered]
                waiting += [(name, EFFECTS) for name in module.imported]
                waiting.append(module.imports.get("*"))
            waiting += [(name, EFFECTS) for name in _modules(code.imports)]
            waiting += [self._at(one) for one in code.declared]
            waiting += [self._resolve(module, chain, code.imports) for chain in code.names]
        return found

    def module(self, name: str) -> Module | None:
        """Return a module by its name; None if it belongs neither to kinedex nor to a plugin, or does not exist."""
        if name.partition(".")[0] not in self._packages:
            return None
        if name not in self._modules:
            path = self._path(name)
            self._modules[name] = None if path is None else _module(name, path, *_stamp(path))
        return self._modules[name]

    def _path(self, name: str) -> Path | None:
        package, *rest = name.split(".")
        if package != PACKAGE:
            with suppress(Exception):  # importing a third-party package to find its modules can raise anything
                spec = importlib.util.find_spec(name)
                if spec is not None and spec.origin is not None and spec.origin.endswith(".py"):
                    return Path(spec.origin)
            return None
        path = _folder(self._root, rest[0]).joinpath(*rest[1:]) if rest else self._root
        candidates = [path.with_suffix(".py"), path / "__init__.py"] if rest else [
            path / PACKAGE / "__init__.py", path / "__init__.py"
        ]  # fmt: skip
        return next((path for path in candidates if path.is_file()), None)

    def _resolve(self, module: Module, chain: str, local: Mapping[str, Place]) -> Place | None:
        """Return the definition that a name refers to; None if it belongs neither to kinedex nor to a plugin."""
        head, *rest = chain.split(".")
        if head in local:
            return self._at(local[head], rest)
        if head in module.definitions:
            return module.name, head
        return self._at(module.imports[head], rest) if head in module.imports else None

    def _at(self, place: Place, rest: Sequence[str] = (), depth: int = 0) -> Place | None:
        """Return the definition of a name or attribute, following imports; None outside of kinedex and its plugins.

        A name that a module does not define stands for the whole module.
        """
        base, name = place
        module = self.module(base)
        if module is None or depth > 20:
            return None
        if not name:
            return self._at((base, rest[0]), rest[1:], depth + 1) if rest else (base, WHOLE)
        if name in module.definitions:
            return base, name
        if name in module.imports and module.imports[name] != place:
            return self._at(module.imports[name], rest, depth + 1)
        inner = f"{base}.{name}"
        return (base, WHOLE) if self.module(inner) is None else self._at((inner, WHOLE), rest, depth + 1)


def _stamp(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=1024)
def _module(name: str, path: Path, _mtime_ns: int, _size: int) -> Module:
    return Module(name, path)
