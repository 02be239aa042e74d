"""Select the skeleton mappings of an ingest: shipped ones, those that its parameters name, and those in the store."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from kinedex.catalog.skeletons.mappings import Mappings, load_mappings
from kinedex.catalog.skeletons.own_mappings import OwnFile, own_files, with_own
from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.storage.snapshot.manifest import Manifest


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
