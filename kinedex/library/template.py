"""Define motion templates as Python objects, learned from takes, made from a clip or read from a file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.catalog.template_files import read_templates
from kinedex.library.arguments import checked_methods
from kinedex.library.take import ANALYSIS_RATE_HZ, FEATURES, Take
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import in_seconds
from kinedex.ops.templates.derived_templates import Contrast, contrast
from kinedex.ops.templates.templates import Kind, NamedTemplate
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.templates.template_learning import (
    SubclassTemplate,
    as_subclass_template,
    learn_template,
    learned_template,
    usable_clips,
)
from kinedex.reports.template_text import contrast_lines, template_heading

if TYPE_CHECKING:
    import polars as pl

    from kinedex.reports.matrix_pictures import MatrixPicture


Examples = Callable[[], Mapping[str, Take]]


def _no_examples() -> dict[str, Take]:
    return {}


@checked_methods
class Template:
    """A motion template: the average of aligned examples of a class, with one row of feature values per column.

    Templates are returned by `Template.learn`, `Template.from_clip` and `Template.load`, and by a store in which a
    pipeline has learned templates (``store.template("squat")``). ``len(template)`` is the number of columns.

    Attributes
    ----------
    name : str
        The name of the class (subclass) that the template represents.
    kind : str
        "soft" if the values are fractions of the clips, "hard" if only values that all clips share are kept.
    values : float64 array (N, f)
        The fraction of the clips in which each of f features is on, 0 to 1, in N columns.
    weights : float64 array (N,)
        The weight of each column, about 1.
    feature_weights : float64 array (f,) or None
        The weight of each feature; None if all features have the same weight.
    clips : tuple of str
        The names of the clips from which the template was learned; empty for a template that was read from a file.
    remarks : tuple of str
        Remarks on the clips, one sentence each.
    rate_hz : float
        Columns per second.
    feature_set : FeatureSet
        The features of the columns.

    Examples
    --------
    >>> template = Template.learn(clips, name="squat")
    >>> template.values.shape == (len(template), 40)
    True
    """

    def __init__(
        self,
        learned: SubclassTemplate,
        feature_set: FeatureSet,
        rate_hz: float = ANALYSIS_RATE_HZ,
        examples: Examples = _no_examples,
    ) -> None:
        self.learned = learned
        self.feature_set = feature_set
        self.rate_hz = rate_hz
        self.examples = examples
        self.name = learned.subclass
        self.kind = learned.kind
        self.clips = learned.clips
        self.remarks = learned.remarks
        self.values = learned.learned.template.values
        self.weights = learned.learned.template.weights
        self.feature_weights = learned.learned.template.feature_weights

    @classmethod
    def learn(
        cls,
        takes: Iterable[Take],
        name: str | None = None,
        kind: Kind = "soft",
        *,
        weights: Mapping[str, float] | None = None,
    ) -> Template:
        """Learn a template from clips of one class.

        Parameters
        ----------
        takes : iterable of Take
            The clips: whole takes, or intervals of takes such as ``take[30:90]``.
        name : str, optional
            The name of the class; by default the `class` of the takes, which must then be the same for all of them.
        kind : {"soft", "hard"}
            "soft" averages the clips; "hard" keeps the values that all clips have in common.
        weights : mapping of str to float, optional
            The weights of features by name, 1 by default; a feature of weight 0 is ignored.

        Returns
        -------
        Template
            The template, which is exactly the one that a pipeline learns from the same clips.

        Raises
        ------
        KinedexError
            There is no clip or no name, or all clips have invalid frames in their middle.

        Examples
        --------
        >>> template = Template.learn(clips, name="squat", weights={"rhand_fast": 0})
        >>> template.clips == tuple(sorted(clip.name for clip in clips))
        True
        """
        from kinedex.pipelines.templates.training import feature_weights

        every = list(takes)
        if not every:
            raise KinedexError("no clip to learn from: `takes` is empty")
        features = _common_features(every)
        called = _common_class(every) if name is None else name
        words = {label: take.words() for label, take in sorted((take.label, take) for take in every)}
        if len(words) < len(every):
            raise KinedexError("two of the clips have the same name and interval; each clip counts once")
        known = {take.label: take.known for take in every if take.known != ALL_KNOWN}
        actors = {take.label: str(take.info.get("actor") or "") for take in every}
        training = usable_clips(called, words, known, actors)
        counts = feature_weights(weights or {}, features)
        found = learned_template(training, kind, learn_template(training, kind, len(features.features), counts))
        return cls(
            found,
            features,
            every[0].rate_hz,
            lambda: {take.label: take for take in sorted(every, key=lambda take: take.label)},
        )

    @classmethod
    def from_clip(
        cls, take: Take, start: int | str | None = None, stop: int | str | None = None, name: str | None = None
    ) -> Template:
        """Make a template of one example.

        Parameters
        ----------
        take : Take
            The take that is the example or contains it.
        start, stop : int or str, optional
            The frames of the example, ``45`` or ``"1.5s"``, stop excluded; by default the whole take. Invalid frames
            at the ends are cut off.
        name : str, optional
            The name of the template; by default that of the take.

        Returns
        -------
        Template
            The template, with one column per frame.

        Raises
        ------
        KinedexError
            The interval is not within the take, or has invalid frames in the middle.

        Examples
        --------
        >>> len(Template.from_clip(take, 0, 30))
        30
        """
        from kinedex.pipelines.templates.stored_templates import frame_range, template_of_frames

        first, last = frame_range(take.name, len(take), take.rate_hz, start, stop)
        features = len(take.feature_set.features)
        made = template_of_frames(take.words(), take.name, first, last, features, name or take.name, take.known)
        example = {take[first:last].label: take[first:last]}
        return cls(as_subclass_template(made, origin=made.description), take.feature_set, take.rate_hz, lambda: example)

    @classmethod
    def load(cls, path: str | Path, name: str | None = None, *, feature_set: str | Path = FEATURES) -> Template:
        """Read a template file.

        Parameters
        ----------
        path : str or Path
            A file ending in .yaml, .yml or .csv.
        name : str, optional
            The template to read if the file has several.
        feature_set : str or Path, optional
            The feature set that the file refers to.

        Returns
        -------
        Template
            The template.

        Raises
        ------
        ConfigError
            The file is invalid; the message names the line.
        KinedexError
            The file has no template of this name, or has several and none is named.

        Examples
        --------
        >>> template.save(folder / "squat.yaml")
        >>> bool((Template.load(folder / "squat.yaml").values == template.values).all())
        True
        """
        features = load_feature_set(feature_set)
        found = {one.name: one for one in read_templates(path, features)}
        if name is None and len(found) > 1:
            raise KinedexError(f"{path} holds {len(found)} templates; pass `name`: {', '.join(found)}")
        if name is not None and name not in found:
            raise KinedexError(f"{path} has no template '{name}'{did_you_mean(name, found)}")
        return cls(as_subclass_template(found[name or next(iter(found))], origin=f"from {Path(path).name}"), features)

    def save(self, path: str | Path) -> None:
        """Write the template to a file that people can edit.

        Parameters
        ----------
        path : str or Path
            A path ending in .yaml, .yml or .csv. A CSV file must be named after the template, and does not store the
            weights of columns.

        Raises
        ------
        KinedexError
            The extension or the name does not fit, or the folder is missing.

        Examples
        --------
        >>> template.save(folder / "squat.yaml")
        """
        from kinedex.pipelines.templates.stored_templates import write_template

        write_template(self.named, self.feature_set, Path(path))

    @property
    def named(self) -> NamedTemplate:
        """Return the template in the form in which template files store it.

        Returns
        -------
        NamedTemplate
            Name, template and description.
        """
        return NamedTemplate(self.name, self.learned.learned.template, self.description)

    @property
    def description(self) -> str:
        """Return a line of text that describes the template and its origin.

        Returns
        -------
        str
            Name, kind, duration and origin.
        """
        return template_heading(self.learned, self.rate_hz)

    def __len__(self) -> int:
        """Return the number of columns."""
        return len(self.values)

    def __repr__(self) -> str:
        return f"Template({self.description!r})"

    def _repr_html_(self) -> str:
        return self.plot().svg()

    def plot(self, delta: float = 0.05) -> Picture:
        """Draw the template, its quantised form, and the consistency of each feature.

        Parameters
        ----------
        delta : float, optional
            Values within delta of 0 and 1 count as off and on; the others are wildcards.

        Returns
        -------
        Picture
            The matrix of features over time, which a notebook shows.

        Examples
        --------
        >>> template.plot()
        Picture('squat')
        """
        from kinedex.reports.matrix_pictures import template_picture

        note = self.description.split(": ", 1)[-1]
        template = self.learned.learned.template
        return Picture(template_picture(template, self.name, note, delta, self.feature_set, self.rate_hz))

    def diff(self, other: Template, delta: float = 0.05) -> Difference:
        """Compare two templates, and return the features and times at which they contradict each other.

        Parameters
        ----------
        other : Template
            The template to compare with, over the same features.
        delta : float, optional
            Values within delta of 0 and 1 count as off and on; other values never contradict.

        Returns
        -------
        Difference
            The contradictions as a table, as text and as a picture.

        Raises
        ------
        KinedexError
            The templates have different features.

        Examples
        --------
        >>> template.diff(template).table.height
        0
        """
        if self.feature_set.digest != other.feature_set.digest:
            raise KinedexError(
                f"the templates have different features: {self.feature_set.name} and {other.feature_set.name}"
            )
        found = contrast(self.learned.learned.template, other.learned.learned.template, delta)
        return Difference(self, other, found, delta)


class Difference:
    """The contradictions between two templates that were aligned by DTW.

    ``print(difference)`` describes them in words.

    Attributes
    ----------
    names : tuple of str
        The names of the two templates.
    share : float
        The share of contradictions among the entries that are wildcards in neither template; NaN if there are no such
        entries.

    Examples
    --------
    >>> difference = template.diff(Template.from_clip(take))
    >>> 0 <= difference.share <= 1
    True
    """

    def __init__(self, first: Template, second: Template, found: Contrast, delta: float) -> None:
        self.names = (first.name, second.name)
        compared = int(found.compared.sum())
        self.share = int(np.abs(found.against).sum()) / compared if compared else float("nan")
        self._first, self._second, self._found, self._delta = first, second, found, delta

    def __str__(self) -> str:
        return "\n".join(contrast_lines(self.names, self._found, self._first.feature_set, self._first.rate_hz))

    def __repr__(self) -> str:
        return f"Difference({self.names[0]!r}, {self.names[1]!r}, share={self.share:.3f})"

    def _repr_html_(self) -> str:
        return self.plot().svg()

    @property
    def table(self) -> pl.DataFrame:
        """Return the contradictions, by descending number of columns.

        Returns
        -------
        polars.DataFrame
            The columns are feature, on_in and off_in (names of the templates), columns (the number of contradicting
            template columns), and on_start_seconds, on_stop_seconds, off_start_seconds and off_stop_seconds (the times
            in both templates).
        """
        import polars as pl

        rows = []
        for index, feature in enumerate(self._first.feature_set.features):
            for on, sign in enumerate((1, -1)):
                path = self._found.path[self._found.against[:, index] == sign]
                if len(path):
                    spans = [(path[:, side].min(), path[:, side].max() + 1) for side in (on, 1 - on)]
                    times = [in_seconds(float(end), self._first.rate_hz) for span in spans for end in span]
                    rows.append((feature.name, self.names[on], self.names[1 - on], len(path), *times))
        times_of = {f"{side}_{end}_seconds": pl.Float64 for side in ("on", "off") for end in ("start", "stop")}
        schema = {"feature": pl.String, "on_in": pl.String, "off_in": pl.String, "columns": pl.Int64, **times_of}
        return pl.DataFrame(rows, schema, orient="row").sort("columns", descending=True, maintain_order=True)

    def plot(self) -> Picture:
        """Draw the two aligned templates, and the entries that contradict each other.

        Returns
        -------
        Picture
            Three matrices of features over time, which a notebook shows.

        Examples
        --------
        >>> template.diff(Template.from_clip(take, name="other")).plot()
        Picture('squat and other')
        """
        from kinedex.reports.matrix_pictures import contrast_picture

        one, other = self._first.learned.learned.template, self._second.learned.learned.template
        note = str(self).splitlines()[0]
        features, rate_hz = self._first.feature_set, self._first.rate_hz
        return Picture(contrast_picture(one, other, self.names, self._found, self._delta, note, features, rate_hz))


def _common_features(takes: list[Take]) -> FeatureSet:
    names = {take.feature_set.digest: take.feature_set.name for take in takes}
    if len(names) > 1:
        raise KinedexError(f"the takes have different feature sets: {', '.join(sorted(names.values()))}")
    return takes[0].feature_set


def _common_class(takes: list[Take]) -> str:
    found = sorted({str(take.info.get("class")) for take in takes if take.info.get("class")})
    if len(found) != 1 or any(not take.info.get("class") for take in takes):
        raise KinedexError(f"the takes are of {', '.join(found) or 'no class'}; pass `name`, the class of the template")
    return found[0]


@checked_methods
class Picture:
    """A picture of a template, or of the difference of two templates.

    A notebook shows the picture as SVG.

    Attributes
    ----------
    title : str
        The title of the picture.

    Examples
    --------
    >>> template.plot().svg().startswith("<svg")
    True
    """

    def __init__(self, figure: MatrixPicture) -> None:
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
        from kinedex.reports.matrix_pictures import draw

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
        from kinedex.reports.matrix_pictures import write_matrices

        write_matrices(self._figure, Path(path))
