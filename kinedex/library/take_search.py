"""Search a store from Python, with keyframe queries, learned templates, and rankings by templates."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from kinedex.library.take import Take
from kinedex.library.take_collection import TakeCollection
from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.intervals import Hit, Interval
from kinedex.storage.store.store import data_frame

if TYPE_CHECKING:
    import polars as pl

    from kinedex.catalog.queries.keyframe_query import KeyframeQuery
    from kinedex.library.query import Query
    from kinedex.library.template import Template
    from kinedex.ops.templates.templates import Kind

_BESIDE_HITS = ("run", "saved_as")


class TakeSearch(TakeCollection):
    """The methods of `Store` for searches and rankings."""

    def search(self, query: Query | Iterable[Query] | str | Path, *, where: str | None = None) -> pl.DataFrame:
        """Return the hits of keyframe queries.

        Parameters
        ----------
        query : Query, sequence of Query, str or Path
            Queries, or a query file with several queries, given by its shipped name or the path of a YAML file.
        where : str, optional
            A SQL filter over the columns of takes.

        Returns
        -------
        polars.DataFrame
            One row per interval with hits, in the order of queries, take names and starts: query, take_id, take, start,
            stop (frames), start_seconds, stop_seconds.

        Raises
        ------
        KinedexError
            A query needs features that the store does not have, or the filter is not valid.
        ConfigError
            The query file is invalid; the message names the line.
        StoreError
            The index is missing or stale; the message names the command that builds it.

        Warns
        -----
        UserWarning
            A query is not applied to takes whose bodies lack joints, or only with its entries of known features.

        Examples
        --------
        >>> "squat" in store.search("example")["query"]
        True
        """
        from kinedex.library.query import resolved_queries
        from kinedex.pipelines.keyframes.store_search import load_query_file, search_remarks, search_store

        if isinstance(query, str | Path):
            queries: Sequence[KeyframeQuery] = load_query_file(query, self.feature_set, rate_hz=self.rate_hz)
        else:
            queries = resolved_queries(query, self.feature_set, self.rate_hz)
        for remark in search_remarks(self.stored, queries, where):
            warnings.warn(remark, stacklevel=2)
        return data_frame(search_store(self.stored, queries, where)).drop(_BESIDE_HITS)

    def map(self, unit: Literal["takes", "windows"] = "takes") -> pl.DataFrame:
        """Lay out the takes in two dimensions by their words, so that takes of similar motion are close together.

        The method needs ``pip install 'kinedex[map]'``, and runs for seconds to a minute. With more than 5,000 points,
        a random sample is laid out, and each other point is put beside the most similar point of the sample.

        Parameters
        ----------
        unit : {"takes", "windows"}, optional
            A point stands for a take, or for a window of some four seconds of a take.

        Returns
        -------
        polars.DataFrame
            One row per point, in the order of takes: take_id, take, start, stop (frames), x, y (between −1 and 1),
            cluster (0 is the largest, null for none), and traits: the features that distinguish the cluster.

        Raises
        ------
        KinedexError
            scikit-learn is not installed.

        Examples
        --------
        >>> places = store.map()
        >>> places.height == len(store)
        True
        """
        import polars as pl

        from kinedex.pipelines.inspection.archive_map import archive_map, trait_words

        if unit not in ("takes", "windows"):
            raise ParameterError("unit", "'takes' or 'windows'", unit)
        found = archive_map(self.stored, unit)
        descriptions = [feature.description for feature in self.feature_set.features]
        texts = [trait_words(one.traits, descriptions) for one in found.clusters]
        clusters = [None if number < 0 else number for number in found.numbers.tolist()]
        return pl.DataFrame(
            {
                "take_id": found.take_ids,
                "take": [self.stored.take_names[take_id] for take_id in found.take_ids.tolist()],
                "start": found.starts,
                "stop": found.stops,
                "x": found.positions[:, 0],
                "y": found.positions[:, 1],
                "cluster": pl.Series(clusters, dtype=pl.Int64),
                "traits": pl.Series([None if one is None else texts[one] for one in clusters], dtype=pl.String),
            }
        )

    def explain(
        self, take: str | int | Take, start: int | None = None, stop: int | None = None, *, label: str | None = None
    ) -> pl.DataFrame:
        """Explain by quantities which class an interval of a take shows.

        The class is compared with the most probable of the others. Examples are the labels of people, and takes with a
        class; those of this take are left out, unless a class has no others.

        Parameters
        ----------
        take : str, int or Take
            The take.
        start, stop : int, optional
            The frames [start, stop); by default the whole take.
        label : str, optional
            The class to explain; by default the most probable one.

        Returns
        -------
        polars.DataFrame
            A row for each quantity, those that say most first: ``class`` and ``other``, with ``probability`` and
            ``other_probability``, which are not calibrated; ``speaks`` ("for" or "against" the class); ``text``;
            ``quantity``, ``unit`` and ``value``; the tenth and ninetieth percentiles of the examples, ``low`` and
            ``high`` of the class, ``other_low`` and ``other_high``; ``below``, the share of its examples that have
            less; and ``share``, the part of the difference of log densities.

        Raises
        ------
        KinedexError
            There is no such class, the interval is not within the take, its body cannot be described, or fewer than two
            classes have examples.

        Examples
        --------
        >>> store.explain(take).select("class", "speaks", "quantity", "text").columns
        ['class', 'speaks', 'quantity', 'text']
        """
        import polars as pl

        from kinedex.pipelines.templates.stored_templates import clip_range
        from kinedex.reports.class_explanations import described_labels, explain_interval, reasons_table

        name = self._row(take)["name"]
        interval = clip_range(self.stored, name, start, stop)
        found = explain_interval(self.stored, described_labels(self.stored), name, interval, label)
        facts = [found.label, found.other, found.probability, found.other_probability]
        names = ["class", "other", "probability", "other_probability"]
        columns = [pl.lit(value).alias(column) for column, value in zip(names, facts, strict=True)]
        return data_frame(reasons_table(found)).select(*columns, pl.all())

    def templates(self, *, stage: str | None = None) -> pl.DataFrame:
        """Return the list of the templates that pipelines have learned.

        Parameters
        ----------
        stage : str, optional
            The stage whose templates are returned: ``"pipeline/stage"``, or the name of the pipeline; by default the
                        stages of the pipeline whose templates the view ``templates`` shows.

        Returns
        -------
        polars.DataFrame
            One row per template: stage, subclass, kind, columns, seconds, clips and others.

        Raises
        ------
        KinedexError
            The store has no templates yet.

        Examples
        --------
        >>> store.templates().select("subclass", "kind").height > 0
        True
        """
        from kinedex.pipelines.templates.stored_templates import templates_overview

        return data_frame(templates_overview(self.stored, 0.05, stage))

    def template(self, name: str, kind: Kind = "soft", *, stage: str | None = None) -> Template:
        """Return a template that a pipeline has learned.

        Parameters
        ----------
        name : str
            The class (subclass) of the template.
        kind : {"soft", "hard"}
            The kind of the template.
        stage : str, optional
            The stage that learned the template, if several did: ``"pipeline/stage"``, or the name of the pipeline.

        Returns
        -------
        Template
            The template.

        Raises
        ------
        KinedexError
            There is no template of this name and kind, or several stages have one.

        Examples
        --------
        >>> store.template("squat1Reps").kind
        'soft'
        """
        from kinedex.library.template import Template
        from kinedex.pipelines.templates.stored_templates import choose_template

        learned = choose_template(self.stored, name, kind, stage)
        return Template(learned, self.feature_set, self.rate_hz, lambda: self._clips(learned.clips))

    def _clips(self, names: Sequence[str]) -> Mapping[str, Take]:
        """Return a dict from name to take for clips that still exist in the store, as takes or intervals of takes."""
        from kinedex.pipelines.templates.examples import interval_of

        places = {name: interval_of(name, self._rows) for name in names}
        return {name: self[take][frames] for name, (take, frames) in places.items() if take in self._rows}

    def rank(
        self,
        template: Template | str | Sequence[Template | str],
        top: int | None = 20,
        *,
        tau: float = 0.1,
        delta: float = 0.1,
        queries: Query | Iterable[Query] | None = None,
        where: str | None = None,
        workers: int | None = None,
        mirror: bool = False,
    ) -> pl.DataFrame:
        """Rank intervals of the takes by their DTW distance from templates.

        Parameters
        ----------
        template : Template, str, or a sequence of them
            Templates, names of learned templates, or paths of template files.
        top : int, optional
            The largest number of hits of a template; None returns all.
        tau : float, optional
            An interval is a hit if its distance is below tau.
        delta : float, optional
            Entries of a template within delta of 0 or 1 count; the others are wildcards.
        queries : Query or sequence of Query, optional
            A template is ranked only within the hits of the queries whose target has its name, or in all frames if
            there are no such queries.
        where : str, optional
            A SQL filter over the columns of takes.
        workers : int, optional
            The number of threads; by default the number of cores. The hits do not depend on it.
        mirror : bool, optional
            True also ranks by the mirror images of the templates, which are the same motions of the other body side.

        Returns
        -------
        polars.DataFrame
            One row per hit, the best of each template first: template, rank, take_id, take, start, stop (frames),
            start_seconds, stop_seconds, cost; with `mirror` also mirrored, which is true for hits of mirror images.

        Raises
        ------
        KinedexError
            A template cannot be found or has only wildcards, no take is selected, or features cannot be mirrored.
        ParameterError
            The number of hits or the threshold is out of range.

        Warns
        -----
        UserWarning
            Templates are excluded or not applied to some takes; only some of the templates have queries; or a template
            has no hit, in which case the warning names the nearest interval and the tau that would make it a hit.

        Examples
        --------
        >>> hits = store.rank("squat1Reps", top=3)
        >>> hits.columns[:4]
        ['template', 'rank', 'take_id', 'take']
        """
        from kinedex.library.query import resolved_queries
        from kinedex.library.template import Template
        from kinedex.pipelines.templates.store_ranking import RankingQuestion, rank_store

        _check_ranking(top, tau)
        wanted = [template] if isinstance(template, Template | str) else list(template)
        found = rank_store(
            self.stored,
            [one.named if isinstance(one, Template) else one for one in wanted],
            RankingQuestion(delta, tau, top, where, mirror, nearest=1, workers=workers),
            queries=None if queries is None else resolved_queries(queries, self.feature_set, self.rate_hz),
        )
        for remark in (*found.remarks, *found.misses(tau, "tau=")):
            warnings.warn(remark, stacklevel=2)
        return data_frame(found.table()).drop("run")

    def similar(
        self,
        take: str | int | Take | Sequence[str],
        start: int | str | None = None,
        stop: int | str | None = None,
        top: int | None = 20,
        *,
        rejected: Sequence[str] = (),
        tau: float = 0.5,
        delta: float = 0.1,
        where: str | None = None,
        workers: int | None = None,
        mirror: bool = False,
    ) -> pl.DataFrame:
        """Rank intervals of the takes by their similarity to an example, or to several of the same motion.

        Words find the candidates, as in `rank`, and numbers such as poses, speeds and turns order them.

        Parameters
        ----------
        take : str, int, Take, or a sequence of str
            The take that is the example or contains it. A `Take` need not be in a store; start and stop then count the
            frames of the `Take`. Several examples are given by the names of intervals of the store, such as
            ``["walk_1[30:75]", "mirror of walk_2[10:52]"]``.
        start, stop : int or str, optional
            The frames of the example within the take, ``45`` or ``"1.5s"``, stop excluded; by default the whole take.
        top : int, optional
            The largest number of hits; None returns all.
        rejected : sequence of str, optional
            Names of intervals that do not show the motion. Hits that are more similar to one of these come last.
        tau : float, optional
            An interval is a candidate if its distance is below tau.
        delta : float, optional
            Entries of the template within delta of 0 or 1 count; the others are wildcards.
        where : str, optional
            A SQL filter over the columns of takes.
        workers : int, optional
            The number of threads; by default the number of cores. The hits do not depend on it.
        mirror : bool, optional
            True also finds the mirror images of the motion.

        Returns
        -------
        polars.DataFrame
            One row per hit as for `rank`, the most similar first, with two more columns: similarity, which is at most
            1, and probable, which is true for hits that differ from the example little more than similar intervals of
            the archive differ from each other. Both are null for takes that lack joints of the example, and beyond the
            600 candidates of least cost; these hits come last. The example itself is a hit if its take is searched.

        Raises
        ------
        KinedexError
            There is no such take, or the interval is not within the take or has invalid frames in the middle.

        Warns
        -----
        UserWarning
            As for `rank`, or the example lacks joints, so that the hits are in the order of their costs.

        Examples
        --------
        >>> store.similar(take, 0, 30, top=1)["cost"][0]
        0.0
        """
        from kinedex.library.template import Template
        from kinedex.pipelines.templates.chosen_intervals import hit_of, template_of_chosen
        from kinedex.pipelines.templates.example_ranking import rank_by_examples
        from kinedex.pipelines.templates.store_ranking import RankingQuestion
        from kinedex.pipelines.templates.stored_templates import clip_range, frame_range

        _check_ranking(top, tau)
        stored, unlike = self.stored, [hit_of(one, self.stored) for one in rejected]
        question = RankingQuestion(delta, tau, top, where, mirror, nearest=1, workers=workers)
        examples: Sequence[Hit | F64]
        if isinstance(take, Take):
            first, last = frame_range(take.name, len(take), take.rate_hz, start, stop)
            template = Template.from_clip(take, start, stop).named
            examples = [_joints_of(take[first:last], stored.feature_set.joints)]
        else:
            if isinstance(take, str | int):
                chosen = take if isinstance(take, str) else self[take].name
                accepted = [Hit(Interval(chosen, *clip_range(stored, chosen, start, stop)))]
            elif start is None and stop is None:
                accepted = [hit_of(one, stored) for one in take]
            else:
                raise ParameterError("start and stop", "left out for several examples, whose names have frames", start)
            name = accepted[0].interval.take if len(accepted) == 1 else "example"
            template = template_of_chosen(stored, name, accepted, unlike, delta).named
            examples = accepted
        found = rank_by_examples(stored, template, examples, question, unlike)
        for remark in (*found.remarks, *found.misses(tau, "tau=")):
            warnings.warn(remark, stacklevel=2)
        return data_frame(found.table()).drop("run")


def _joints_of(take: Take, joints: Sequence[str]) -> F64:
    """Return the positions of a take at given joints, float64 (T, J, 3); NaN for joints that it has not."""
    place = {joint: number for number, joint in enumerate(take.joints)}
    positions = take.positions.astype(np.float64)
    lost = np.full_like(positions[:, 0], np.nan)
    return np.stack([positions[:, place[joint]] if joint in place else lost for joint in joints], axis=1)


def _check_ranking(top: int | None, tau: float) -> None:
    """Raise an error unless the number of hits and the threshold of a ranking are in range."""
    if top is not None and top < 1:
        raise ParameterError("top", "at least 1, or None", top)
    if not tau > 0:
        raise ParameterError("tau", "above 0", tau)
