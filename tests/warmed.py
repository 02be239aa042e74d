"""Modules that a parent process imports before it forks, so that modules and compiled code are loaded once."""

from __future__ import annotations

import hypothesis  # noqa: F401
import polars  # noqa: F401
import pytest  # noqa: F401

import kinedex.storage.store.compaction
import kinedex.storage.store.verification  # noqa: F401
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.pipelines.ingestion import read_passes
from kinedex.pipelines.ingestion.analysis import analyse, known_features, measured_quality, unknown_feature_warnings
from kinedex.storage.formats.motion.reader_table import persons_of, read_body

body = load_feature_set()
read_passes._compile_kernels(body)
load_mappings("auto", body.joints)
code_digest(read_body, persons_of, analyse, unknown_feature_warnings, known_features, measured_quality)
