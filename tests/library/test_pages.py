"""Pages of moving figures that Python writes."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

import kinedex


def test_a_page_has_a_figure_for_each_interval_and_examples(store: kinedex.Store, tmp_path: Path) -> None:
    hits = store.rank("squat1Reps", top=3)
    page = kinedex.write_page(store, hits, tmp_path / "hits.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == len(hits)
    assert page.count("nearest example") > len(hits)
    take = next(iter(store))
    intervals = pl.DataFrame({"take": [take.name], "start": [3], "stop": [20]})
    page = kinedex.write_page(store, intervals, tmp_path / "one.html", title="<one>").read_text(encoding="utf-8")
    assert page.count("<figure>") == 1
    assert "<h1>&lt;one&gt;</h1>" in page
    assert (
        kinedex.write_page(store, intervals.to_arrow(), tmp_path / "two.html", title="<one>").read_bytes()
        == (tmp_path / "one.html").read_bytes()
    )


def test_a_page_of_something_else_is_refused_before_any_file_is_written(store: kinedex.Store, tmp_path: Path) -> None:
    name = next(iter(store)).name
    good = pl.DataFrame({"take": [name], "start": [3], "stop": [20]})
    with pytest.raises(kinedex.ParameterError, match="ending in"):
        kinedex.write_page(store, good, tmp_path / "one.pdf")
    with pytest.raises(kinedex.ParameterError, match="a column 'stop'"):
        kinedex.write_page(store, good.drop("stop"), tmp_path / "one.html")
    with pytest.raises(kinedex.ParameterError, match="a column 'actr'"):
        kinedex.write_page(store, good, tmp_path / "one.html", group="actr")
    with pytest.raises(kinedex.KinedexError, match="are no interval of its"):
        kinedex.write_page(store, good.with_columns(stop=10**6), tmp_path / "one.html")
    with pytest.raises(kinedex.KinedexError, match="did you mean"):
        kinedex.write_page(store, good.with_columns(take=pl.lit(name + "x")), tmp_path / "one.html")
    assert list(tmp_path.iterdir()) == []
