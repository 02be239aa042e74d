"""Progress bars that count, for tests of what long work says of itself."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class CountedBars:
    """Makes bars as a context does; `seen` has the description, the total and what was done, of each in its order."""

    def __init__(self) -> None:
        self._bars: list[CountedBar] = []

    def __call__(self, description: str, total: int) -> CountedBar:
        self._bars.append(CountedBar(description, total))
        return self._bars[-1]

    @property
    def seen(self) -> list[tuple[str, int, int]]:
        """Return what each bar would have shown at its end."""
        return [(bar.description, bar.total, bar.done) for bar in self._bars]


class CountedBar:
    """A bar that counts."""

    def __init__(self, description: str, total: int) -> None:
        self.description, self.total, self.done = description, total, 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def advance(self, n: int = 1) -> None:
        """Count what is done."""
        self.done += n
