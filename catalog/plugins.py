"""Find parts of kinedex, such as stages, by name: built-in ones, and plugins of installed distributions."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Generic, TypeVar

from kinedex.ops.errors import KinedexError, did_you_mean

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint  # its import is slow, and most processes load no part

Part = TypeVar("Part")

_log = logging.getLogger("kinedex.plugins")


class PluginError(KinedexError):
    """A plugin cannot be used; the message names its distribution and what is wrong with it."""


class Plugins(Generic[Part]):
    """A registry of parts of one kind, such as stages, by name; each part is imported on first access.

    An installed distribution adds a part by an entry point of the group, in its pyproject.toml::

        [project.entry-points."kinedex.stages"]
        count_frames = "my_package.count_frames:CountFrames"

    Built-in parts are written in the same form, and cannot be replaced.

    Parameters
    ----------
    group : str
        The group of entry points, such as "kinedex.stages".
    noun : str
        The word for one part in messages, such as "stage".
    built_in : mapping of str to str
        A mapping from the name of each built-in part to its location, "module:object".
    """

    def __init__(self, group: str, noun: str, built_in: Mapping[str, str]) -> None:
        self.group = group
        self.noun = noun
        self._places = dict(built_in)

    def __contains__(self, name: object) -> bool:
        return name in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def load(self, name: str) -> Part:
        """Import and return the part with the given name.

        Raises
        ------
        PluginError
            The part belongs to a plugin that cannot be imported.
        KinedexError
            No part has this name.
        """
        known = self._all()
        if name not in known:
            raise KinedexError(f"there is no {self.noun} '{name}'{did_you_mean(name, known)}")
        if name in self._built_in:
            return known[name].load()  # type: ignore[no-any-return]
        try:
            return known[name].load()  # type: ignore[no-any-return]
        except Exception as fault:  # a plugin's code may raise anything on import
            raise PluginError(
                f"the {self.noun} '{name}' of {self.distribution(name)} cannot be imported "
                f"({type(fault).__name__}: {fault}); upgrade or uninstall that distribution"
            ) from fault

    def loadable(self) -> Iterator[tuple[str, Part]]:
        """Yield every part with its name; plugins that cannot be imported are logged as warnings and skipped."""
        for name in self._all():
            try:
                yield name, self.load(name)
            except PluginError as fault:
                _log.warning("%s", fault)

    def distribution(self, name: str) -> str:
        """Return the distribution of a plugin and its version, such as "my-stages 1.2"; empty for a built-in part."""
        found = self._all()[name]
        return _distribution(found) if name not in self._built_in else ""

    def place(self, name: str) -> str:
        """Return the location of a part, as "module:object"."""
        return self._all()[name].value

    @cached_property
    def _built_in(self) -> dict[str, EntryPoint]:
        from importlib.metadata import EntryPoint

        return {name: EntryPoint(name, value, self.group) for name, value in self._places.items()}

    def _all(self) -> dict[str, EntryPoint]:
        return self._built_in | {
            name: found for name, found in _installed(self.group, tuple(sys.path)).items() if self._is_free(found)
        }

    def _is_free(self, found: EntryPoint) -> bool:
        """Return whether a plugin's name is not that of a built-in part; warn if it is."""
        if found.name in self._built_in:
            _warn_once(
                f"the {self.noun} '{found.name}' of {_distribution(found)} is not used, because a built-in {self.noun} "
                "has this name; give it another one"
            )
        return found.name not in self._built_in


@lru_cache(maxsize=32)
def _installed(group: str, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; of two with the same name, the first on the path is used."""
    from importlib.metadata import entry_points

    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        other = found.setdefault(point.name, point)
        if other.value != point.value:
            _log.warning(
                "%s and %s both have '%s' in the group %s; the first is used",
                _distribution(other), _distribution(point), point.name, group,
            )  # fmt: skip
    return found


@lru_cache(maxsize=256)
def _warn_once(text: str) -> None:
    _log.warning("%s", text)


def _distribution(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "an unknown distribution"
