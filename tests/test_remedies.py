"""Errors carry their remedy; those classes that do not are listed here, with the reason."""

from __future__ import annotations

import importlib
import pickle
import pkgutil

import pytest

import kinedex
from kinedex.ops.errors import KinedexError, Remedy, StoreError

WITHOUT = {
    "KinedexError": "asks for something that does not fit; the message names what would",
    "ParameterError": "an argument is out of its domain; the message states the domain",
    "SourceError": "a source file is wrong; the message names file and line, and only its author can correct it",
    "ConfigError": "a configuration file is wrong; the message names file, line, key and the nearest valid name",
    "NewStoreError": "the store is sound but another one is needed; only the user can choose its place",
    "AcceptError": "the user has to decide; the runner adds `--accept` to the command as the remedy of StageFailed",
    "PluginError": "a distribution of somebody else is wrong; the message names it",
    "UnknownName": "SQL asks for a name that does not exist; the message lists those that do",
    "NoFoldsError": "the archive has too few takes for a split; the message counts them",
    "TimeLimitError": "a query took longer than the limit that it was given; the message names the limit",
    "WriteError": "the disk refuses a file of the store; the message names the file, the reason and the way out",
    "UnwritableError": "the disk refuses a file of an export; the message names the file and the reason",
    "MissingPackageError": "a package is not installed; the message has the command of pip",
    "UnusableRecording": "a key of a recordings file does not fit; the message names the key",
    "ReadOnlyError": "an explorer was started with --read-only; the message names the option",
    "NotFoundError": "an address of the explorer names a take that is not there",
    "ConflictError": "what a page shows is not what is there any more; the message tells what to read again",
    "CancelledWorkError": "nobody reads it: who asked has gone",
    "WorkerDied": "a task needs more memory than there is; the message names the option",
}
"""Classes whose errors have no remedy of their own: the message itself is the way out."""

WITH = {
    "StoreError": "damage has `kinedex repair`, a held lock `--wait`; others name what is missing in the message",
    "DamagedManifest": "`kinedex repair`",
    "Unreadable": "turned into an error with `kinedex repair` by the connection of the store",
    "StageFailed": "the remedy of the fault that stopped the stage",
}
"""Classes whose errors have a remedy where there is one; tests/pipelines/ingestion/test_store_repair.py runs the
commands."""


def classes(of: type[KinedexError] = KinedexError) -> set[type[KinedexError]]:
    return {of}.union(*(classes(one) for one in of.__subclasses__()))


def test_every_class_of_errors_has_a_remedy_or_a_reason_for_none() -> None:
    for module in pkgutil.walk_packages(kinedex.__path__, "kinedex."):
        if "__main__" not in module.name:
            importlib.import_module(module.name)
    found = {one.__name__ for one in classes() if one.__module__.startswith("kinedex.")}
    assert found == {*WITHOUT, *WITH}


@pytest.mark.parametrize("kind", [KinedexError, StoreError])
def test_a_remedy_ends_the_message_and_outlives_a_process(kind: type[KinedexError]) -> None:
    remedy = Remedy("`kinedex repair s` repairs it", ("kinedex", "repair", "s"))
    fault = pickle.loads(pickle.dumps(kind("s/x: is missing", remedy=remedy)))
    assert str(fault) == "s/x: is missing; `kinedex repair s` repairs it"
    assert fault.remedy == remedy
    assert kind("s/x: is missing").remedy is None
