"""The parameters of the stage ingest, what a store remembers of them, and the skeleton mappings that they select."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PrivateAttr, field_validator

from kinedex.catalog.skeletons.mappings import Mappings, OwnFile, load_mappings, own_files, with_own
from kinedex.pipelines.engine.file_parameters import NamesFile, StageParameters
from kinedex.pipelines.ingestion.known_files import Naming
from kinedex.pipelines.ingestion.memory_limit import parse_size
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, ReadSettings
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.schemas import GROUP_COLUMN, TakeColumn
from kinedex.storage.store.store import Store


class IngestParameters(StageParameters):
    """The parameters of the stage `ingest`."""

    source: Annotated[str, NamesFile("data")] = Field(description="folder that holds the motion files, at any depth")
    skeleton: Annotated[str, NamesFile("skeletons")] = Field(
        "auto",
        description="skeleton mapping: `auto` recognises the body of each file; a shipped name or a path to a .yaml "
        "file counts for all files of its format, whatever their names (other formats stay automatic)",
    )
    skeletons: Annotated[list[str], NamesFile("file")] = Field(
        default_factory=list,
        description="skeleton mappings of your own (.yaml files, or folders of them), which go before the shipped ones "
        "where the names of a file fit; vocabularies of names, too. Those that the store holds (`kinedex mapping add`) "
        "are added",
    )
    skeleton_files: dict[str, str] = Field(
        default_factory=dict,
        description="ASF files of AMC files, and static trials of files of markers, where the name does not tell: a "
        "path below the source, in which * and ? stand for any characters, or the name of a file, to the path of its "
        'ASF or static trial below the source: `{"walk_*.amc": "subject7.asf"}`; the first that fits counts',
    )
    features: Annotated[str | None, NamesFile("features")] = Field(
        None,
        description="feature set: a shipped name, or a path to a .yaml file; unless given that of the store, and "
        "`body40` in a new one; a store has one for good",
    )
    patterns: list[str] = Field(
        default_factory=list,
        description="regular expressions with named groups (actor, class, clip, any other), tried in order on the path "
        "relative to the source; the first that is found anywhere in it counts",
    )
    metadata: Annotated[list[str], NamesFile("data")] = Field(
        default_factory=list,
        description="tables (.csv, .tsv, .yaml, .json) whose rows name takes or files, and whose other columns become "
        "columns of takes: tags, licence, any other; their actor, class and clip go before those of paths",
    )
    name: Naming = Field(
        "stem",
        description="the name of a take: its file's stem, its path without the ending (`path`), or with it (`file`)",
    )
    rate_hz: float | None = Field(
        None,
        ge=SLOWEST_HZ,
        le=FASTEST_HZ,
        description="frames per second of files that do not say it: Acclaim (120 unless given), CSV, NPY, some NPZ",
    )
    override_rate_hz: float | None = Field(
        None,
        ge=SLOWEST_HZ,
        le=FASTEST_HZ,
        description="frames per second of every file, in place of its own rate (`kinedex ingest --rate`)",
    )
    fill_gap_frames: int | None = Field(
        None,
        ge=0,
        description="longest gap of a point, in source frames, that is closed along a straight line (C3D, TRC, CSV, "
        "NPZ, NPY); a tenth of a second unless given; the frames of a longer one are invalid and get no word",
    )
    body_model: Annotated[str | None, NamesFile("data")] = Field(
        None,
        description="body model of AMASS files: model.npz of SMPL-H, or its joints at rest (.npz, .csv, .yaml); "
        "{gender} in the path stands for male, female or neutral",
    )
    prune: bool = Field(False, description="drop takes whose file is no longer in the source")
    strict: bool = Field(False, description="stop at the first file that does not come in, and fail with its message")
    batch_mb: int = Field(64, ge=1, le=4096, description="most megabytes of raw files that one task reads")
    max_memory: str | None = Field(
        None,
        description="most memory of all workers together, such as 1.5GB; a file that needs more than the share of one "
        "worker is refused before it is read",
    )
    _from_store: tuple[str, ...] = PrivateAttr(())

    @field_validator("skeletons", "metadata", mode="before")
    @classmethod
    def _is_list(cls, places: object) -> object:
        return [places] if isinstance(places, str | os.PathLike) else [] if places is None else places

    @field_validator("max_memory")
    @classmethod
    def _is_size(cls, size: str | None) -> str | None:
        if size is not None:
            parse_size(size)
        return size

    @field_validator("patterns")
    @classmethod
    def _compiles(cls, patterns: list[str]) -> list[str]:
        for pattern in patterns:
            try:
                re.compile(pattern)
            except re.error as fault:
                raise ValueError(f"'{pattern}' is no regular expression: {fault}") from None
        return patterns

    @property
    def remembered(self) -> dict[str, Any]:
        """The parameters that a store remembers for a source, as JSON values with absolute file paths.

        Parameters of a single run (prune, strict, batch_mb, max_memory) are excluded.
        """
        values = self.model_dump(mode="json", exclude={"prune", "strict", "batch_mb", "max_memory"})
        values |= {"source": self.root}
        for name in ("skeleton", "features", "body_model"):
            if values[name] is not None and Path(values[name]).suffix:
                values[name] = str(Path(values[name]).expanduser().absolute())
        for name in ("skeletons", "metadata"):
            values[name] = [str(Path(place).expanduser().absolute()) for place in values[name]]
        return values

    @property
    def root(self) -> str:
        """The absolute path of the source folder, with links resolved."""
        return os.path.realpath(Path(self.source).expanduser())

    @property
    def tables(self) -> tuple[str, ...]:
        """The absolute paths of the tables of metadata."""
        return tuple(str(Path(place).expanduser().absolute()) for place in self.metadata)

    @property
    def from_store(self) -> tuple[str, ...]:
        """The names of the unset parameters whose values the store remembers for the source."""
        return self._from_store

    def with_remembered(self, values: Mapping[str, Any]) -> IngestParameters:
        """Return the parameters with remembered values; `from_store` names those that differ."""
        merged = IngestParameters.model_validate(self.model_dump(exclude_unset=True) | dict(values))
        merged._from_store = tuple(name for name in values if getattr(merged, name) != getattr(self, name))
        return merged

    @property
    def group_columns(self) -> dict[str, TakeColumn]:
        """The columns of takes for the named groups of the patterns, except actor, class and clip."""
        names = dict.fromkeys(name for pattern in self.patterns for name in re.compile(pattern).groupindex)
        return {name: GROUP_COLUMN for name in names if name not in ("actor", "class", "clip")}

    @property
    def given(self) -> ReadSettings:
        """The user's settings for reading files."""
        model = None if self.body_model is None else str(Path(self.body_model).expanduser().absolute())
        return ReadSettings(self.rate_hz, self.override_rate_hz, self.fill_gap_frames, model)


def with_remembered(params: IngestParameters, unset: frozenset[str], store: Store) -> IngestParameters:
    """Return the parameters of an ingest, with unset ones, except `features`, taken from the source's last ingest.

    Parameters
    ----------
    params : IngestParameters
        The parameters.
    unset : frozenset of str
        The names of the parameters that the user has not set.
    store : Store
        The store.
    """
    settings = _settings_of(params.root, store)
    # a store never changes its feature set
    return params.with_remembered({name: settings[name] for name in settings if name in unset - {"features"}})


def _settings_of(root: str, store: Store) -> dict[str, Any]:
    """Return the settings of a source, or of the source that was moved to its path; empty for a new one."""
    sources = store.manifest.sources
    if root in sources:
        return sources[root].settings
    gone = [former for former in sources if not os.path.isdir(former)]
    if not gone:
        return {}
    rows = store.take_columns("source_root", "source").to_pylist()
    for former in sorted(gone, key=lambda former: sources[former].recorded, reverse=True):
        if any(os.path.isfile(os.path.join(root, row["source"])) for row in rows if row["source_root"] == former):
            return sources[former].settings
    return {}


def remembered_line(params: IngestParameters) -> str:
    """Return a message that lists the parameters which the store remembers."""
    shown = ", ".join(f"{name} {_short(getattr(params, name))}" for name in params.from_store)
    return f"as at the last ingest of this source: {shown}; `--set ingest.{params.from_store[0]}=…` sets another"


def _short(value: object) -> str:
    if isinstance(value, list) and value:
        return f"'{value[0]}'" + (f" and {len(value) - 1} more" if len(value) > 1 else "")
    return f"'{value}'" if isinstance(value, str) else "none" if value in (None, []) else str(value)


def stored_files(store: Path, texts: Mapping[str, str]) -> tuple[OwnFile, ...]:
    """Return the skeleton mappings and vocabularies in a store (`Manifest.mappings`), as files."""
    return tuple(OwnFile(Path(f"{store} (mapping {name})"), text, stored=True) for name, text in sorted(texts.items()))


def chosen_mappings(
    params: IngestParameters, joints: tuple[str, ...], store: Path, manifest: Manifest | None
) -> Mappings:
    """Return the skeleton mappings with which the files of an ingest are read.

    Parameters
    ----------
    params : IngestParameters
        The parameters of the stage.
    joints : tuple of str
        The named joints of the feature set.
    store : Path
        The directory of the store.
    manifest : Manifest or None
        The manifest of the store; None before the store exists.

    Raises
    ------
    ConfigError
        There is no such mapping, or it is invalid.
    """
    stored = stored_files(store, manifest.mappings) if manifest is not None else ()
    files = (*own_files(params.skeletons), *stored)
    mappings = load_mappings(params.skeleton, joints)
    return with_own(mappings, files, joints) if files else mappings
