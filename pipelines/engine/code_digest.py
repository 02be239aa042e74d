"""Digests of code: a hash of the definitions that a function or class can reach, for fingerprints of its results.

A digest follows names. It starts at a definition, reads its syntax tree, and goes on with the definition that each name
in it stands for, through imports, wherever that is in kinedex or in the package of a plugin. Annotations are followed
as well, as they give the classes of the objects whose methods are called, but do not count themselves. Docstrings and
comments do not count. Of a class count its bases, its fields, and the methods whose names occur in the code that is
reached; where code asks for attributes by computed names, all methods of the classes that its module knows.

What follows from this: a stage depends on the protocols that it is run by (`Executor`, `Display`), which it names, and
not on the classes that implement them, which only the runner names.

Where names cannot be followed, more counts: a module that is used as a value, or by an attribute that it does not
define, counts as a whole; so do statements of imported modules that are no plain definitions. Code that is imported by
a computed name has to be declared: a string "package.module:name" is followed as a name is, which makes tables of
built-in parts work without more. Plugins count where they are used (`part_digest`).
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Self

from kinedex.catalog.plugins import Plugins

PACKAGE = "kinedex"

ROOT = Path(__file__).resolve().parents[2]
"""The folder of the rooms: in a checkout, or in the installed package."""

_DECLARED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+:[A-Za-z_]\w*")
_PLAIN = frozenset(
    {"staticmethod", "classmethod", "property", "cached_property", "abstractmethod", "lru_cache", "cache"}
)
"""Decorators after which a method runs where its name is used, and nowhere else."""

_BLIND = _PLAIN | {"njit", "contextmanager", "wraps"}
"""Decorators that do not look at annotations; after others annotations count."""

Place = tuple[str, str]
"""A module and a name in it; an empty name stands for all of the module."""


def code_digest(*roots: Callable[..., object] | type | str) -> str:
    """Return a hash of the code that functions or classes can run.

    Parameters
    ----------
    *roots : functions, classes, or texts "module:name"
        Where to begin.

    Returns
    -------
    str
        Sixteen hexadecimal digits.
    """
    return _digest(tuple(sorted(_place(root) for root in roots)))


def part_digest(parts: Plugins[Any], name: str) -> str:
    """Return a hash of a plugin's code, and of its distribution's name and version; empty for a built-in part.

    Built-in parts count already where the table of them is used.
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
    known = _known_digests()
    key = " ".join(":".join(place) for place in roots)
    found = known.get(key)
    sources = Sources()
    if found is None or any(sources.stamp(name) != tuple(stamp) for name, stamp in found["files"].items()):
        found = known[key] = {"digest": sources.digest(roots), "files": sources.stamps()}
        if all(module.partition(".")[0] == PACKAGE for module, _ in roots):
            _keep_digests(known)
    return str(found["digest"])


@lru_cache(maxsize=1)
def _known_digests() -> dict[str, dict[str, Any]]:
    """Return the digests of earlier processes by their roots, each with the files that it was made of."""
    with suppress(OSError, ValueError):
        known = json.loads(_kept_digests().read_text(encoding="utf-8"))
        if isinstance(known, dict):
            return known
    return {}


def _keep_digests(known: Mapping[str, object]) -> None:
    """Write digests for later processes; where the installation is read-only, they are made again each time."""
    path = _kept_digests()
    other = path.with_name(f"{path.name}.{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        other.write_text(json.dumps(known), encoding="utf-8")
        other.replace(path)


def _kept_digests() -> Path:
    """Return the file of digests, which is another one for another version of this module or of Python."""
    version = f"{sys.version_info.major}{sys.version_info.minor}-{_stamp(Path(__file__))[0]:x}"
    return Path(__file__).resolve().parent / "__pycache__" / f"code_digest-{version}.json"


@dataclass
class Code:
    """The content of one definition, apart from docstrings, comments and annotations.

    Attributes
    ----------
    package : str
        The package of its module.
    text : str
        A hash of the syntax tree.
    names : set of str
        Names and chains of attributes on names, such as "np.zeros".
    attributes : set of str
        All names of attributes.
    imports : dict of str to Place
        The names that imports inside of it bind.
    declared : set of Place
        The places that strings "module:name" declare.
    computed : bool
        It asks for an attribute by a computed name.
    """

    package: str
    text: str = ""
    names: set[str] = field(default_factory=set)
    attributes: set[str] = field(default_factory=set)
    imports: dict[str, Place] = field(default_factory=dict)
    declared: set[Place] = field(default_factory=set)
    computed: bool = False
    _parts: list[str] = field(default_factory=list)
    _blind: bool = False

    def read(self, nodes: Iterable[ast.AST]) -> Self:
        """Add all that stands in syntax trees, in one pass over them."""
        for node in nodes:
            self._read(node)
        self.text = hashlib.sha256("\0".join(self._parts).encode("utf-8", "backslashreplace")).hexdigest()
        self._parts.clear()
        return self

    def _read(self, node: ast.AST) -> None:
        self._parts.append(type(node).__name__)
        if isinstance(node, ast.Name):
            self.names.add(node.id)
            self._parts.append(node.id)
            return
        if isinstance(node, ast.Attribute):
            self.attributes.add(node.attr)
            chain = _chain(node)
            if chain is not None:
                self.names.add(chain)
                self.attributes.update(chain.split(".")[1:])
                self._parts.append(chain)
                return
        elif isinstance(node, ast.Constant):
            if isinstance(node.value, str) and _DECLARED.fullmatch(node.value):
                self.declared.add(_place(node.value))
            self._parts.append(repr(node.value))
            return
        elif isinstance(node, ast.Import | ast.ImportFrom):
            self.imports |= _bound(node, self.package)
        elif isinstance(node, ast.Call):
            self._note_getattr(node)
        self._read_fields(node)

    def _read_fields(self, node: ast.AST) -> None:
        before = self._blind
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            self._blind = _decorators(node) <= _BLIND
        elif isinstance(node, ast.ClassDef):
            self._blind = False
        for name, value in ast.iter_fields(node):
            if self._blind and name in ("returns", "annotation"):
                self._follow(value)
            elif isinstance(value, ast.AST):
                self._parts.append(name)
                self._read(value)
            elif isinstance(value, list):
                if value and name != "type_params":
                    self._parts.append(name)
                docstring = name == "body" and _has_docstring(node)
                for one in value[int(docstring) :]:
                    if isinstance(one, ast.AST):
                        self._read(one)
                    else:
                        self._parts.append(repr(one))
                self._parts.append(".")
            elif value is not None and name not in ("ctx", "type_comment", "kind"):
                self._parts.append(f"{name}={value!r}")
        self._blind = before

    def _follow(self, node: ast.AST | None) -> None:
        """Add the names of an annotation without its text."""
        chain = _chain(node) if node is not None else None
        if chain is not None:
            self.names.add(chain)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            with suppress(SyntaxError):
                self._follow(ast.parse(node.value, mode="eval").body)
        elif node is not None:
            for part in ast.iter_child_nodes(node):
                self._follow(part)

    def _note_getattr(self, call: ast.Call) -> None:
        name = call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")
        if (name in ("getattr", "hasattr") and len(call.args) > 1) or name in ("attrgetter", "methodcaller"):
            asked = call.args[1:2] if name.endswith("attr") else call.args
            for one in asked:
                if isinstance(one, ast.Constant) and isinstance(one.value, str):
                    self.attributes.update(one.value.split("."))
                else:
                    self.computed = True


def _chain(node: ast.AST) -> str | None:
    """Return a name with attributes as a text, "a.b.c"; None for attributes of anything else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        before = _chain(node.value)
        return None if before is None else f"{before}.{node.attr}"
    return None


def _decorators(node: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    chains = [_chain(one.func if isinstance(one, ast.Call) else one) or "" for one in node.decorator_list]
    return {chain.rpartition(".")[2] for chain in chains}


def _has_docstring(node: ast.AST) -> bool:
    body = getattr(node, "body", None)
    documented = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module)
    return documented and isinstance(body, list) and bool(body) and _is_text(body[0])


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _bound(node: ast.Import | ast.ImportFrom, package: str) -> dict[str, Place]:
    """Return the names that an import binds; "*" for all names of a module."""
    if isinstance(node, ast.Import):
        return {
            one.asname or one.name.partition(".")[0]: (one.name if one.asname else one.name.partition(".")[0], "")
            for one in node.names
        }
    base = node.module or ""
    if node.level:
        above = package.split(".")[: len(package.split(".")) - node.level + 1]
        base = ".".join([*above, base] if base else above)
    return {one.asname or one.name: (base, one.name) for one in node.names}


class Module:
    """One module of kinedex or of a plugin: its definitions, its imports, and its other statements.

    Attributes
    ----------
    name : str
        The name that it is imported by.
    definitions : dict of str to list of ast.stmt
        The statements that define each name.
    classes : dict of str to ast.ClassDef
        The classes among them.
    imports : dict of str to Place
        The names that imports bind, those for type checkers included.
    imported : list of str
        The modules that are imported when this one is.
    effects : list of ast.stmt
        The statements that are no plain definitions and run on import.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        self.definitions: dict[str, list[ast.stmt]] = {}
        self.classes: dict[str, ast.ClassDef] = {}
        self.imports: dict[str, Place] = {}
        self.imported: list[str] = []
        self.effects: list[ast.stmt] = []
        self._codes: dict[str, Code] = {}
        for statement in ast.parse(path.read_bytes()).body:
            self._add(statement)
        for name_, statements in self.definitions.items():
            if any(self._registers(one) for one in statements):
                self.effects += [one for one in statements if one not in self.effects]
            last = statements[-1]
            if isinstance(last, ast.ClassDef):
                self.classes[name_] = last

    def _add(self, statement: ast.stmt) -> None:
        match statement:
            case ast.Import() | ast.ImportFrom():
                self._add_import(statement)
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                self.definitions.setdefault(name, []).append(statement)
            case ast.Assign(targets=targets) if names := _target_names(targets):
                for name in names:
                    self.definitions.setdefault(name, []).append(statement)
            case ast.AnnAssign(target=ast.Name(id=name)):
                self.definitions.setdefault(name, []).append(statement)
            case ast.AugAssign(target=ast.Name(id=name)) if name in self.definitions:
                self.definitions[name].append(statement)
            case ast.If(test=test) if ast.unparse(test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
                for node in ast.walk(statement):
                    if isinstance(node, ast.Import | ast.ImportFrom):
                        self.imports |= _bound(node, self.package)
            case ast.If(test=test) if ast.unparse(test) == "__name__ == '__main__'":
                pass
            case _ if not _is_text(statement):
                self.effects.append(statement)
                for node in ast.walk(statement):
                    if isinstance(node, ast.Import | ast.ImportFrom):
                        self._add_import(node)

    def _add_import(self, node: ast.Import | ast.ImportFrom) -> None:
        bound = _bound(node, self.package)
        self.imports |= bound
        if isinstance(node, ast.Import):
            self.imported += [one.name for one in node.names]
        else:
            for base, name in bound.values():
                self.imported += [base, f"{base}.{name}"]

    def _registers(self, statement: ast.stmt) -> bool:
        """Return whether a definition has a decorator of this project, which may do anything with it on import."""
        for decorator in getattr(statement, "decorator_list", ()):
            function = decorator.func if isinstance(decorator, ast.Call) else decorator
            head = (_chain(function) or "").partition(".")[0]
            if head in self.definitions or self.imports.get(head, ("", ""))[0].partition(".")[0] == PACKAGE:
                return True
        return False

    def code(self, name: str) -> Code:
        """Return what a definition consists of, of a class without methods; "Class.method" for one of these."""
        if name not in self._codes:
            self._codes[name] = Code(self.package).read(self._nodes(name))
        return self._codes[name]

    def _nodes(self, name: str) -> list[ast.AST]:
        owner, dot, method = name.partition(".")
        if dot:
            return [one for one in self.classes[owner].body if getattr(one, "name", "") == method]
        if name in self.classes:
            return list(_header(self.classes[name]))
        return list(self.definitions[name])

    @cached_property
    def effect_code(self) -> Code:
        """The statements that are no plain definitions."""
        return Code(self.package).read(self.effects)

    def methods(self, owner: str) -> list[str]:
        """Return the names of the methods of a class that run only when they are called by name."""
        return [one.name for one in self.classes[owner].body if _is_method(one)]  # type: ignore[attr-defined]


def _target_names(targets: list[ast.expr]) -> list[str]:
    names: list[str] = []
    for target in targets:
        parts = target.elts if isinstance(target, ast.Tuple) else [target]
        if not all(isinstance(part, ast.Name) for part in parts):
            return []
        names += [part.id for part in parts if isinstance(part, ast.Name)]
    return names


def _is_method(node: ast.stmt) -> bool:
    """Return whether a statement of a class is a method that only a call by its name runs."""
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or node.name.startswith("__"):
        return False
    return _decorators(node) <= _PLAIN


def _header(node: ast.ClassDef) -> Iterator[ast.AST]:
    yield from node.decorator_list
    yield from node.bases
    yield from node.keywords
    yield from (one for one in node.body[_has_docstring(node) :] if not _is_method(one) and not _is_text(one))


class Sources:
    """The modules that digests are made of.

    Parameters
    ----------
    root : Path, optional
        The folder of the rooms; that of this program by default.
    """

    def __init__(self, root: Path = ROOT) -> None:
        self._root = root
        self._packages = {PACKAGE}
        self._modules: dict[str, Module | None] = {}

    def digest(self, roots: Iterable[Place]) -> str:
        """Return a hash of all definitions that are reached from some."""
        hasher = hashlib.sha256()
        for (module, name), text in sorted(self.reached(roots).items()):
            hasher.update(f"{module}:{name}={text}\n".encode())
        return hasher.hexdigest()[:16]

    def reached(self, roots: Iterable[Place]) -> dict[Place, str]:
        """Return all definitions that are reached from some, and the hash of each."""
        roots = list(roots)
        for module, _ in roots:
            if (package := module.partition(".")[0]) not in self._packages:
                self._packages.add(package)
                self._modules.clear()
        return _Reach(self, roots).found

    def module(self, name: str) -> Module | None:
        """Return a module; None where it is not of kinedex or of a plugin, or does not exist."""
        if name not in self._modules:
            path = self._path(name) if name.partition(".")[0] in self._packages else None
            self._modules[name] = None if path is None else _module(name, path, *_stamp(path))
        return self._modules[name]

    def stamps(self) -> dict[str, tuple[str, int, int]]:
        """Return the files of the modules that were looked for, with time and size; see `stamp`."""
        return {name: self.stamp(name) for name in self._modules if name.partition(".")[0] in self._packages}

    def stamp(self, name: str) -> tuple[str, int, int]:
        """Return a module's path, time in ns, and size in bytes; an empty path where there is none."""
        path = self._path(name)
        return ("", 0, 0) if path is None else (str(path), *_stamp(path))

    def _path(self, name: str) -> Path | None:
        package, *rest = name.split(".")
        if package != PACKAGE:
            with suppress(Exception):  # packages of others are imported to find their modules
                spec = importlib.util.find_spec(name)
                if spec is not None and spec.origin is not None and spec.origin.endswith(".py"):
                    return Path(spec.origin)
            return None
        path = self._root.joinpath(*rest)
        candidates = [path.with_suffix(".py"), path / "__init__.py"] if rest else [
            path / PACKAGE / "__init__.py", path / "__init__.py"
        ]  # fmt: skip
        return next((path for path in candidates if path.is_file()), None)

    def resolve(self, module: Module, chain: str, local: Mapping[str, Place]) -> Place | None:
        """Return the definition that a name stands for in a module; None where it is of no module of these.

        Parameters
        ----------
        module : Module
            Where the name is used.
        chain : str
            The name with its attributes, such as "genetics.evolve".
        local : mapping of str to Place
            Names that imports inside of the definition bind.
        """
        head, *rest = chain.split(".")
        if head in local:
            return self.at(local[head], rest)
        if head in module.definitions:
            return module.name, head
        return self.at(module.imports[head], rest) if head in module.imports else None

    def at(self, place: Place, rest: Sequence[str] = (), depth: int = 0) -> Place | None:
        """Return the definition at a place, or at attributes of it; that of another module where it is imported."""
        base, name = place
        module = self.module(base)
        if module is None or depth > 20:
            return None
        if not name:
            return self.at((base, rest[0]), rest[1:], depth + 1) if rest else (base, "")
        if name in module.definitions:
            return base, name
        if name in module.imports and module.imports[name] != place:
            return self.at(module.imports[name], rest, depth + 1)
        inner = f"{base}.{name}"
        return (base, "") if self.module(inner) is None else self.at((inner, ""), rest, depth + 1)


def _stamp(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=1024)
def _module(name: str, path: Path, _mtime_ns: int, _size: int) -> Module:
    return Module(name, path)


class _Reach:
    """The definitions that are reached from some; found are the hashes of their code."""

    def __init__(self, sources: Sources, roots: Iterable[Place]) -> None:
        self.found: dict[Place, str] = {}
        self._sources = sources
        self._queue: list[tuple[Module, Code]] = []
        self._used: set[str] = set()
        self._unused: dict[str, list[Place]] = {}
        self._imported: set[str] = set()
        for place in roots:
            self._reach_whole(place)
        while self._queue:
            self._follow(*self._queue.pop())

    def _reach(self, place: Place) -> None:
        name, definition = place
        module = self._sources.module(name)
        if place in self.found or module is None:
            return
        self._import(name)
        if not definition:
            self.found[place] = ""
            for one in module.definitions:
                self._reach((name, one))
                self._keep_methods((name, one))
            return
        code = module.code(definition)
        self.found[place] = code.text
        self._queue.append((module, code))
        if definition in module.classes:
            if self._is_called_by_others(module, definition):
                self._keep_methods(place)
            for method in module.methods(definition):
                if method in self._used:
                    self._reach((name, f"{definition}.{method}"))
                else:
                    self._unused.setdefault(method, []).append((name, f"{definition}.{method}"))

    def _reach_whole(self, place: Place) -> None:
        """Reach what a place holds, of a class all methods: it is called from where no name can be followed."""
        found = self._sources.at(place)
        if found is not None:
            self._reach(found)
            self._keep_methods(found, inherited=True)

    def _keep_methods(self, place: Place, *, inherited: bool = False) -> None:
        """Reach all methods of a class, and those of its bases if asked for."""
        name, definition = place
        module = self._sources.module(name)
        if module is None or definition not in module.classes:
            return
        for method in module.methods(definition):
            self._reach((name, f"{definition}.{method}"))
        for base in module.classes[definition].bases if inherited else ():
            chain = _chain(base.value if isinstance(base, ast.Subscript) else base)
            found = self._sources.resolve(module, chain, {}) if chain else None
            if found is not None:
                self._reach(found)
                self._keep_methods(found, inherited=True)

    def _is_called_by_others(self, module: Module, definition: str) -> bool:
        """Return whether a class has a base of another package, whose code may call any method."""
        for base in module.classes[definition].bases:
            chain = _chain(base.value if isinstance(base, ast.Subscript) else base)
            if chain is None:
                return True
            place = module.imports.get(chain.partition(".")[0])
            if place is not None and self._sources.module(place[0]) is None and place[0] not in ("typing", "abc"):
                return True
        return False

    def _follow(self, module: Module, code: Code) -> None:
        for place in code.imports.values():
            self._import(place[0])
            self._import(".".join(place))
        for chain in code.names:
            found = self._sources.resolve(module, chain, code.imports)
            if found is not None:
                self._reach(found)
        for place in code.declared:
            self._reach_whole(place)
        for attribute in code.attributes - self._used:
            self._used.add(attribute)
            for place in self._unused.pop(attribute, ()):
                self._reach(place)
        if code.computed:
            for place in self._visible_classes(module):
                self._keep_methods(place)

    def _visible_classes(self, module: Module) -> list[Place]:
        """Return the classes of kinedex that a module defines or imports, and those that their fields name."""
        found: list[Place] = []
        waiting = [place for name in (*module.classes, *module.imports) if (place := self._class(module, name))]
        while waiting:
            place = waiting.pop()
            if place in found:
                continue
            found.append(place)
            home = self._sources.module(place[0])
            assert home is not None
            for chain in home.code(place[1]).names:
                other = self._class(home, chain)
                if other is not None:
                    waiting.append(other)
        return [place for place in found if place in self.found]

    def _class(self, module: Module, chain: str) -> Place | None:
        place = self._sources.resolve(module, chain, {})
        home = self._sources.module(place[0]) if place is not None else None
        return place if place is not None and home is not None and place[1] in home.classes else None

    def _import(self, name: str) -> None:
        """Count the statements that run when a module is imported, and its own imports."""
        waiting = [name]
        while waiting:
            one = waiting.pop()
            module = self._sources.module(one)
            if module is None or one in self._imported:
                continue
            self._imported.add(one)
            waiting += [*module.imported, one.rpartition(".")[0]]
            if "*" in module.imports:
                self._reach((module.imports["*"][0], ""))
            if module.effects:
                self.found[one, "*"] = module.effect_code.text
                self._queue.append((module, module.effect_code))
