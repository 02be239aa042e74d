"""Tables of tags, licences and figures are joined to takes as columns, and no motion file is read for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.ingestion import file_batches
from kinedex.pipelines.ingestion.metadata import load_metadata
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive
from tests.pipelines.ingestion.test_remembered_settings import ingest

FILES = ("a/x_al_walk.amc", "a/x_al_run.amc", "b/x_bo_run.amc")
EXCEL = (
    "take;licence;mass [kg];age;indoor;tags;class;code\r\n"
    "x_al_walk;CC BY 4.0;71,5;30;WAHR;slow|calm;walk;007\r\n"
    "a\\x_al_run.amc;privé;80;31;FALSCH;;run;008\r\n"
    "nobody;;;;;;;\r\n"
)
COLUMNS = ("licence", "mass [kg]", "age", "indoor", "tags", "class", "code")


@pytest.fixture(scope="module")
def ingested(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("metadata")
    source = write_archive(folder / "archive", dict.fromkeys(FILES, 30))
    (source / "metadata.csv").write_bytes(EXCEL.encode("cp1252"))
    _, shown = ingest(folder / "store", source, patterns=[r"x_(?P<actor>[a-z]+)_"])
    assert f"{source}/metadata.csv is not used: `--set ingest.metadata={source}/metadata.csv` joins" in shown
    return folder / "store", source


def test_a_table_of_excel_becomes_typed_columns(ingested: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    store, source = ingested
    monkeypatch.setattr(file_batches, "read_body", None)  # no motion file is read for a table
    _, shown = ingest(store, source, metadata=[source / "metadata.csv"])
    assert "2 takes described" in shown
    assert "1 row of metadata without a take, such as 'nobody' (line 4)" in shown
    assert "1 take without a row of metadata, such as 'x_bo_run'" in shown
    opened = open_store(store)
    assert opened.takes().sort("name").select("name", "actor", *COLUMNS).rows() == [
        ("x_al_run", "al", "privé", 80.0, 31, False, None, "run", "008"),
        ("x_al_walk", "al", "CC BY 4.0", 71.5, 30, True, ["slow", "calm"], "walk", "007"),
        ("x_bo_run", "bo", None, None, None, None, None, None, None),
    ]
    types = {name: column.type for name, column in opened.manifest.columns.items() if column.origin == "metadata"}
    assert types == {
        "licence": "VARCHAR", "mass [kg]": "DOUBLE", "age": "BIGINT", "indoor": "BOOLEAN", "tags": "VARCHAR[]",
        "code": "VARCHAR",
    }  # fmt: skip
    found = opened.sql("SELECT name FROM takes WHERE list_contains(tags, 'calm') AND age < 31").to_pylist()
    assert found == [{"name": "x_al_walk"}]

    # the next ingest remembers the table, and a changed one changes rows alone, with wider types
    assert ingest(store, source)[0].ran == ()
    (source / "metadata.csv").write_text(EXCEL.replace(";30;", ";30,5;").replace("nobody;", "x_bo_run;free"))
    outcome, shown = ingest(store, source)
    assert (outcome.summaries["ingest"]["read"], outcome.ran) == (0, ("ingest", "index"))
    assert open_store(store).takes().sort("name").select("licence", "age").rows() == [
        ("privé", 31.0), ("CC BY 4.0", 30.5), ("free", None),
    ]  # fmt: skip

    # without the table values would go, which needs a yes
    before = read_newest(store)
    with pytest.raises(KinedexError, match=r"(?s)3 of 3 takes .* licence: 3 takes, such as 'privé' of x_al_run"):
        ingest(store, source, metadata=[])
    assert read_newest(store) == before
    ingest(store, source, accept=True, metadata=[])
    assert open_store(store).takes().select("class", "licence").unique().rows() == [(None, None)]


def test_yaml_names_takes_by_patterns_and_by_name(ingested: tuple[Path, Path], tmp_path: Path) -> None:
    _, source = ingested
    table = tmp_path / "licences.yaml"
    table.write_text(
        "'*': {licence: free, tags: [mocap]}\n'a/*': {licence: bought}\nx_al_run: {licence: ours, day: 2024-05-01}\n"
    )
    ingest(tmp_path / "store", source, metadata=table)
    assert open_store(tmp_path / "store").takes().sort("name").select("licence", "tags", "day").rows() == [
        ("ours", ["mocap"], "2024-05-01"),
        ("bought", ["mocap"], None),
        ("free", ["mocap"], None),
    ]


ROWS = [{"take_id": n, "name": name, "source": path} for n, (name, path) in enumerate([
    ("x", "a/x.bvh"), ("b/x", "b/x.bvh"), ("y", "c/y.bvh"), ("duet-al", "duet.c3d"), ("duet-bo", "duet.c3d"),
])]  # fmt: skip


def joined(tmp_path: Path, text: str, ending: str = ".csv") -> dict[str, dict[str, object]]:
    path = tmp_path / f"table{ending}"
    path.write_text(text)
    metadata = load_metadata([str(path)])
    found = metadata.join(ROWS, "/archive", metadata.columns({})[0])
    return {str(ROWS[take]["name"]): values for take, values in found.values.items()}


def test_a_key_is_a_name_a_path_or_a_file(tmp_path: Path) -> None:
    text = "file,n\nx,1\n/archive/b/x.bvh,2\n./c/y,3\nduet.c3d,4\n"
    assert joined(tmp_path, text) == {
        "x": {"n": 1}, "b/x": {"n": 2}, "y": {"n": 3}, "duet-al": {"n": 4}, "duet-bo": {"n": 4},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("take,n\nx.bvh,1\n", "table.csv:2: 'x.bvh' fits 2 files, such as a/x.bvh and b/x.bvh; give the path below"),
        ("take,n\ny,1\n\nc/y.bvh,2\n", "table.csv:4: 'c/y.bvh' is the take 'y', of which line 2 gives 'n' already"),
        ("take,n\n,1\n", "table.csv:2: has no value in 'take'"),
        ("take,n\ny,1,2\n", "table.csv:2: has 3 cells, and the header has 2"),
        ("take,N,n\ny,1,2\n", "table.csv:1: has two columns 'n'"),
        ("take,,n\ny,1,2\n", "table.csv:1: column 2 has no name"),
        ("take\ny\n", "table.csv:1: must have a header with two columns"),
    ],
)
def test_faults_of_a_table_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(KinedexError) as fault:
        joined(tmp_path, text)
    assert message in str(fault.value)


def test_an_empty_entry_at_the_head_of_a_yaml_list_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KinedexError, match=r"table.yaml:1: \[0\]: is empty; expected columns, one of which names the"):
        joined(tmp_path, "- {}\n- {take: y, n: 1}\n", ".yaml")


def test_a_column_that_every_store_has_is_reported(ingested: tuple[Path, Path], tmp_path: Path) -> None:
    _, source = ingested
    (tmp_path / "t.csv").write_text("take,frames,Actor\nx_al_run,3,zoe\n")
    _, shown = ingest(tmp_path / "store", source, metadata=tmp_path / "t.csv", patterns=[r"x_(?P<actor>[a-z]+)_"])
    assert "the column 'frames' of metadata is no column of takes: every store has a column of this name" in shown
    assert open_store(tmp_path / "store").takes().sort("name")["actor"].to_list() == ["zoe", "al", "bo"]


def test_a_yaml_file_beside_a_motion_file_describes_its_takes(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "archive", dict.fromkeys(FILES, 30))
    (source / "a" / "x_al_walk.yaml").write_text("file: x_al_walk.amc\nlicence: CC0\ntags: [slow, calm]\nage: 30\n")
    (source / "a" / "x_al_run.yml").write_text("capture: {volume: 3}\n")
    (source / "a" / "other.yaml").write_text("licence: none\n")
    (source / "a" / "x_al_run.yaml").symlink_to(tmp_path / "outside.yaml")
    (tmp_path / "outside.yaml").write_text("licence: secret\n")
    (tmp_path / "table.csv").write_text("tke,age\nx_al_walk,31\n")
    store = tmp_path / "store"
    _, shown = ingest(store, source)
    assert "metadata by 1 YAML file beside motion files: 1 take described" in shown
    assert "1 YAML file beside motion files not used as metadata: " in shown
    assert "x_al_run.yml:1: capture: expected a text, a number" in shown
    columns = ("name", "licence", "tags", "age")
    assert open_store(store).takes().sort("name").select(columns).rows() == [
        ("x_al_run", None, None, None), ("x_al_walk", "CC0", ["slow", "calm"], 30), ("x_bo_run", None, None, None),
    ]  # fmt: skip
    assert "file" not in open_store(store).takes().columns
    assert ingest(store, source)[0].ran == ()
    files = {row["source"]: row["outcome"] for row in open_store(store).result("source_files").to_pylist()}
    assert [files[f"a/{name}"] for name in ("x_al_walk.yaml", "other.yaml", "x_al_run.yaml")] == [
        "metadata", "passed over", "refused",
    ]  # fmt: skip

    # a table that is given goes before, and the key that it takes for want of another is named
    _, shown = ingest(store, source, metadata=[tmp_path / "table.csv"])
    assert "its first, 'tke', names the takes; if 'tke' means 'take', rename it" in shown
    assert open_store(store).takes("name = 'x_al_walk'")["age"].to_list() == [31]
    (source / "a" / "x_al_walk.yaml").write_text("licence: [")
    with pytest.raises(
        KinedexError, match=r"(?s)licence: 1 take, such as 'CC0' of x_al_walk.*x_al_walk.yaml:1: is not"
    ):
        ingest(store, source)
