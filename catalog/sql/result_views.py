"""The views of results that stages have stored, with the rows of the current pipeline or of all pipelines.

A kind of results is registered by its view alone: the view's name is the kind, and its columns are the schema of the
kind's Parquet parts. To add a kind, add a `result_view` to the module of its topic; the views of a new module are added
to `RESULT_VIEWS`. docs/sql.md is generated from the views, and docs/formats.md lists the kinds.
"""

from __future__ import annotations

from kinedex.catalog.sql.annotation_views import ANNOTATION_VIEWS
from kinedex.catalog.sql.archive_views import ARCHIVE_VIEWS
from kinedex.catalog.sql.depth_views import DEPTH_VIEWS
from kinedex.catalog.sql.inertial_views import INERTIAL_VIEWS
from kinedex.catalog.sql.keyframe_views import KEYFRAME_VIEWS
from kinedex.catalog.sql.tracking_views import TRACKING_VIEWS

ALL = "all_"
"""Before the name of a view of results: the view with the same columns that shows the rows of every pipeline."""

SOURCE_KINDS = ("skeleton_files", "source_files", "ingest_log")
"""Results that belong to a source folder, whichever pipeline has ingested it."""

SAVED_KINDS = ("hits", "duplicates", "known_failures")
"""Results that belong to no pipeline: all of them are shown."""

RESULT_VIEWS = (*ANNOTATION_VIEWS, *TRACKING_VIEWS, *DEPTH_VIEWS, *INERTIAL_VIEWS, *KEYFRAME_VIEWS, *ARCHIVE_VIEWS)
