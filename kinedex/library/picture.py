"""Pictures that a notebook shows and that can be saved."""

from __future__ import annotations

from pathlib import Path

from kinedex.library.arguments import checked_methods
from kinedex.reports.matrix_figures import MatrixFigure, draw, write_figure


@checked_methods
class Picture:
    """A picture of a template or of the difference of two.

    A notebook shows it as SVG.

    Attributes
    ----------
    title : str
        The title of the picture.

    Examples
    --------
    >>> template.plot().svg().startswith("<svg")
    True
    """

    def __init__(self, figure: MatrixFigure) -> None:
        self.title = figure.title
        self._figure = figure

    def __repr__(self) -> str:
        return f"Picture({self.title!r})"

    def _repr_svg_(self) -> str:
        return self.svg()

    def svg(self) -> str:
        """Return the picture as SVG.

        Returns
        -------
        str
            One ``svg`` element.

        Examples
        --------
        >>> "</svg>" in template.plot().svg()
        True
        """
        return draw(self._figure, "svg").decode("utf-8")

    def save(self, path: str | Path) -> None:
        """Write the picture to a file.

        Parameters
        ----------
        path : str or Path
            A path ending in .svg or .png.

        Raises
        ------
        KinedexError
            The path has another ending.
        OSError
            The file cannot be written.

        Examples
        --------
        >>> template.plot().save(folder / "template.png")
        """
        write_figure(self._figure, Path(path))
