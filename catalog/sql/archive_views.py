"""Define the views of duplicates and of the source files of the archive."""

from __future__ import annotations

from kinedex.catalog.sql.columns import SECONDS, TAKE, result_view

ARCHIVE_VIEWS = (
    result_view(
        "duplicates",
        "Takes that hold the same file or motion as a longer take, as `kinedex duplicates` found them last.",
        f"""{TAKE}
of_take_id    BIGINT    id of the other take, which is longer, or as long with an earlier name
of_take    VARCHAR    name of the other take
same    VARCHAR    kind of the duplicate: file (a copy of the same file) or motion (the joints move alike)
changes    VARCHAR    what was done to the copy: trimmed, part (only a part is in common), resampled, shifted (by a \
part of a frame), another clock, mirrored, another body; or same frames, or same file; NULL in rows of earlier versions
{SECONDS}
share    DOUBLE    share of the take that the range covers
shift_seconds    DOUBLE    shift in seconds: time t of the take is time t + shift_seconds of the other take
pace    DOUBLE    seconds of the other take in a second of the take; 1 unless their clocks differ
mirrored    BOOLEAN    true if left and right are exchanged
distance_mm    DOUBLE    root mean square distance of the joints of poses that are laid over one another; for another \
body, of the same directions of bones on a body of ordinary size""",
        "SELECT take, of_take, changes, distance_mm FROM duplicates WHERE share > 0.9 ORDER BY take, of_take LIMIT 10",
    ),
    result_view(
        "skeleton_files",
        "The skeleton files that takes were read with, as they were when they were last checked.",
        """source_root    VARCHAR    the folder that was ingested
source    VARCHAR    path of the skeleton file, relative to source_root
source_bytes    BIGINT    size of the file in bytes
source_mtime_ns    BIGINT    time of the last change of the file, in nanoseconds since 1970
checksum    VARCHAR    SHA-256 of the file""",
        "SELECT t.name, t.skeleton_source, s.checksum FROM takes AS t JOIN skeleton_files AS s "
        "ON (s.source_root, s.source) = (t.source_root, t.skeleton_source) ORDER BY t.name LIMIT 10",
        stages="ingest",
    ),
    result_view(
        "source_files",
        "All files below the folder that a stage ingested last, and what became of each.",
        """source_root    VARCHAR    the folder that was ingested
source    VARCHAR    path of the file, relative to source_root; also of a folder that cannot be read
ending    VARCHAR    extension of the file in lower case, with the dot
outcome    VARCHAR    outcome of the ingest: in (the store has the takes of the file), refused, skeleton, metadata, \
not read, passed over (no motion)
takes    INTEGER    number of takes of the file in the store
reason    VARCHAR    the fault and the remedy, or the kind of a file that was passed over""",
        "SELECT outcome, ending, count(*) AS files FROM source_files GROUP BY ALL ORDER BY files DESC, ending",
        stages="ingest",
    ),
    result_view(
        "ingest_log",
        "Source files, or places in them, that could not be read, recordings of sensors among them.",
        """source    VARCHAR    the source file, relative to its root
stage    VARCHAR    the stage that met it
error    VARCHAR    kind of error
message    VARCHAR    the fault and the remedy
file    VARCHAR    the file that is at fault, if it is another file
line    INTEGER    line of the fault, if it is known
logged_at    TIMESTAMP WITH TIME ZONE    time of the log entry""",
        "SELECT source, line, message FROM ingest_log ORDER BY source, line",
        stages="ingest read_imu",
    ),
    result_view(
        "known_failures",
        "Files that failed when a run was told to remember it (`--known-failures remember`).",
        """file    VARCHAR    the file
checksum    VARCHAR    hash of the content of the file, and of another file that is at fault
error    VARCHAR    kind of error; UnmatchedLabels of a label file whose labels match no take
reason    VARCHAR    the fault and the remedy""",
        "SELECT file, reason FROM known_failures ORDER BY file",
    ),
    result_view(
        "accepted_doubts",
        "Warnings and guesses about takes that a person has accepted (`kinedex takes accept`).",
        """take    VARCHAR    name of the take
message    VARCHAR    the message, as the view `doubts` has it
accepted_at    TIMESTAMP WITH TIME ZONE    when""",
        "SELECT take, message FROM accepted_doubts ORDER BY take, message",
    ),
)
