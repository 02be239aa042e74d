"""The JSON objects that commands print with `--json`: their keys, for the reference and its test."""

from __future__ import annotations

_STORE = {"store": "path of the store"}
_UNMATCHED = (
    "for each label file with labels that match no take its `file`, the number of these `labels`, `of` how many, and "
    "the names of `takes` that no take has"
)
_RUN = {
    "pipeline": "name of the pipeline",
    **_STORE,
    "ran": "names of the stages that ran",
    "skipped": "names of the stages that were up to date",
    "report": "path of the report, or null",
    "excluded_files": "number of source files that the ingest excluded (exit code 3 where there are any)",
    "unmatched_labels": f"{_UNMATCHED} (exit code 3 where there are any)",
    "files": "source files that are `new`, `changed` or `gone` since the run before, those that `failed`, and those "
    "`accepted` by `--known-failures remember`, each of these with `file` and `reason`",
    "metrics": "rows of the view `metrics` with the scope `pooled`, one for each evaluation",
}

DOCUMENTS: dict[str, dict[str, str]] = {
    "demo": _RUN,
    "run": _RUN,
    "ingest": _RUN,
    "plan": {
        "pipeline": "name of the pipeline",
        "description": "its description",
        **_STORE,
        "stages": "for each stage its `stage`, `inputs`, `runs_because` (null where it is up to date), "
        "`last_finished` and `last_seconds` (null where it never ran)",
    },
    "export": {
        **_STORE,
        "files": "paths of the files of a take; of a data set metadata.csv and dataset.json, which list the others",
        "folder": "path of the data set; null for one take as a file",
        "clips": "number of its clips",
        "seconds": "length of all clips",
        "written": "number of clips that were written",
        "reused": "number of clips that were there already",
        "splits": "for each split its `clips`, `seconds`, `share` of the time, and `classes` (number of clips)",
        "excluded": "file of a clip that could not be written → the reason (exit code 3 where there are any)",
        "remarks": "what was left out, in words",
    },
    "takes list": {
        **_STORE,
        "seconds": "length of all these takes",
        "takes": "rows with the columns of `--columns`",
    },
    "search": {
        **_STORE,
        "query_file": "the argument QUERIES",
        "takes": "number of takes with hits",
        "saved_as": "name given with `--save`, or null",
        "run": "run of the saved hits, or null",
        "hits": "rows of the view `hits`",
    },
    "search --explain": {
        **_STORE,
        "query_file": "the argument QUERIES",
        "explanation": "for each keyframe the sizes of its lists, the frames that survive it, and times",
    },
    "rank": {
        **_STORE,
        "templates": "names of the templates ranked by",
        "tau": "threshold of hits",
        "delta": "threshold of wildcards",
        "frames": "frames of the takes ranked",
        "seconds": "time of the ranking",
        "remarks": "templates that were excluded, or ranked in all frames for want of a query",
        "hits": "rows of the view `ranked_hits`; with `--mirror` also `mirrored`, by example also `similarity` and "
        "`probable`",
        "nearest": "such rows of the nearest places of templates without a hit",
    },
    **{
        f"labels {name}": {
            **_STORE,
            "counts": "number of new labels by origin (`imported`, `accepted`, `corrected`, `drawn`), or "
            "`without errors`, `rejected` or `removed`",
            "known": "number of decisions that the store had already",
            "remarks": "what was excluded, and why",
            "unmatched_labels": f"{_UNMATCHED} (exit code 3 where there are any)",
            "labels": "the new rows, with the columns of a label and without those that the view adds",
        }
        for name in ("import", "add", "change", "remove", "accept", "reject")
    },
    "labels list": {**_STORE, "labels": "rows of the view `labels`, or of `label_history`"},
    "explain": {
        **_STORE,
        "take": "name of the take",
        "label": "the class that is explained",
        "other": "the most probable other class, which it is compared with",
        "probability": "probability of the class, not calibrated",
        "other_probability": "probability of the other class",
        "evidence": "difference of the log densities of both classes",
        "reasons": "for each quantity what `--format json` shows",
    },
    "labels suspects": {
        **_STORE,
        "judged": "number of labels that were judged",
        "remarks": "how many labels cannot be judged, and why",
        "suspects": "for each label what `--format json` shows",
    },
    "inspect": {
        "file": "path of the file",
        "facts": "what was found out, each with `name` and `value`",
        "features": "for each feature its `feature`, `name`, `percent`, `runs`, `longest_seconds` and `remark`",
        "picture": "path of the picture, or null",
        "sensors": "of a file of sensors, for each its `sensor`, `limb`, `channels`, `rate_hz`, `samples`, `seconds`, "
        "`frame`, `mean_acc_m_s2`, `median_acc_m_s2`, `gyr_correlation`, `gyr_ratio`, `gaps`, `rests` and `warnings`; "
        "else null",
    },
    "mapping list": {
        **_STORE,
        "mappings": "for each mapping or vocabulary that the store keeps its `name`, `kind` and YAML `text`",
    },
    "verify": {
        **_STORE,
        "version": "version of the store that was checked",
        "takes": "number of takes",
        "parts": "number of parts",
        "faults": "number of findings that are damage (exit code 1 where there are any)",
        "findings": "for each its `file`, `problem`, `remedy` (`text` and `command`), and `fault`: true for damage",
    },
    "repair": {
        **_STORE,
        "dry_run": "true where nothing was changed",
        "found": "the findings before the repair, as those of `verify`",
        "done": "what was done, or would be done, line by line",
        "lost_takes": "for each take that could not be made again its `name`, `take_id`, `source` and `why`",
        "quarantine": "for each file that is kept its `file`, `why`, `held`, `sha256` and `stage`",
        "to_run": "commands that make results again, which failed now",
        "faults": "number of findings that are left (exit code 1 where there are any)",
    },
    "upgrade": {
        **_STORE,
        "dry_run": "true where nothing was changed",
        "before": "format that the store had",
        "version": "version of the store afterwards",
        "parts": "number of parts that were checked; 0 where the store has the present format",
        "bytes": "their size",
        "takes_parts": "number of parts of takes that were written again",
        "columns": "columns that takes got, from named groups",
        "damaged": "parts that were kept although they are damaged or missing",
        "index_built": "true where the index had to be built again",
    },
    "versions": {
        **_STORE,
        "versions": "for each its `version`, `created`, `format`, `kinedex`, `command`, `changes`, `takes`, whether it "
        "has an `index`, and the `problem` of one that cannot be read",
    },
    "history list": {
        **_STORE,
        "runs": "for each pipeline run its `run`, `pipeline`, `begun`, `state`, `seconds`, `stages`, `takes`, where "
        "its `results` are, its `kinedex`, and its `changes` from the run before",
    },
    "history show": {
        **_STORE,
        "run": "everything about the pipeline run: its YAML text, settings, sources, command and files, and for each "
        "of its `stages` the parameters that were `given`, all `params`, its `state`, `reason`, `fingerprint` and "
        "`summary`",
    },
    "history export": {
        **_STORE,
        "run": "id of the pipeline run",
        "file": "path of the pipeline file",
        "files": "paths of the files beside it that its parameters name",
        "remarks": "what the file alone does not reproduce, and what to do about it",
    },
    "simulate cameras": {
        "folder": "path of the folder",
        "recordings": "name of each recording → the take that it shows",
        "frames": "number of frames of all recordings",
        "failures": "number of failures in them",
        "recordings_file": "path of the file that `track` reads",
    },
    "simulate depth": {
        "folder": "path of the folder",
        "recordings": "name of each recording → the take that it shows",
        "frames": "number of frames of all recordings",
        "outside": "name of each recording with frames in which a joint is near the camera, or outside the image → "
        "their number",
        "recordings_file": "path of the file that `reconstruct` reads",
    },
    "duplicates": {
        **_STORE,
        "takes": "number of takes of the store",
        "duplicates": "rows of the view `duplicates`, without `run`",
    },
    "takes remove": {
        **_STORE,
        "removed": "true where `--accept` was given",
        "takes": "names of the takes",
        "files": "`source_root` and `source` of the files that ingests pass over from then on",
        "returning": "names of the takes that the next ingest brings back, since other takes of their file stay",
        "tracks": "names of those that were made of recordings, which no motion file holds",
        "labels": "number of their labels, which stay",
    },
    "takes readmit": {
        **_STORE,
        "readmitted": "true where files were given or `--all`",
        "files": "`source_root` and `source` of these files, of all removed ones where none were given",
    },
    "takes accept": {
        **_STORE,
        "accepted": "false with `--revoke`",
        "doubts": "for each doubt its `take` and `message`",
        "changed": "number of those that were not so before",
    },
    "merge": {
        **_STORE,
        "other": "path of the other store",
        "takes": "number of takes that came in",
        "frames": "number of their frames",
        "labels": "number of rows of labels that came in, with those of the history",
        "kept_mappings": "names of skeleton mappings of which the store has others, and keeps them",
        "all_takes": "number of takes of the store now",
        "results_left": "kinds of results of the other store, which do not come along",
    },
    "use": {
        **_STORE,
        "current": "name of the pipeline whose results the views show, or null",
        "chosen": "true where it was chosen; false for the pipeline that was run last",
        "pipeline_runs": "rows of the view `pipeline_runs`",
    },
    "gc": {
        **_STORE,
        "dry_run": "true where nothing was removed",
        "removed": "for each file its `path`, `bytes` and `kind`",
        "open_versions": "for each version that stays because readers have it open its `version` and the number of "
        "`processes`, null where the system does not tell",
    },
    "init": {
        "source": "the argument DIR",
        "patterns": "for each proposed regular expression its `pattern` and the number of `paths` that it was made of",
        "paths": "number of motion files",
        "matched": "number of those that a pattern fits",
        "file": "path of the pipeline that was written, or null",
    },
    "synth": {
        "directory": "the argument DIR",
        "made": "false where the archive was there already",
        "actors": "names of the actors",
        "classes": "names of the classes of motion",
        "clips": "number of training clips",
        "takes": "number of long takes",
        "clip_minutes": "minutes of the clips",
        "take_minutes": "minutes of the takes",
        "frames": "number of source frames",
        "labels": "number of labelled segments of the takes",
        "bytes": "size of all files",
    },
    "sql": {
        **_STORE,
        "columns": "names of the columns; the second of two equal ones, x, is x_1",
        "rows": "the rows, as objects",
        "row_count": "number of rows, also of those beyond `--limit`",
    },
    "sql --path": {**_STORE, "path": "path of the database file"},
    "report compare": {
        "format": "kinedex comparison 1",
        "comparisons": "for each pair of evaluations what the file of `--output FILE.json` has",
    },
    "labels export": {
        **_STORE,
        "files": "paths of the files",
        "takes": "number of takes in them",
        "segments": "number of their segments",
        "by": "who labelled or annotated them",
        "rejected": "number of annotations that are left out, since a person has rejected them",
        "renamed": "take → name of its file, where they differ",
        "excluded": "takes whose names the format would change",
    },
    "labels read": {"files": "the arguments FILE", "segments": "the segments of all files"},
    "labels diff": {
        "before": "the argument BEFORE",
        "after": "the argument AFTER",
        "differences": "for each segment its `change`, its edges and classes before and after, and their `unit`",
        "remarks": "what was excluded, and why",
        "unmatched_labels": f"{_UNMATCHED} (with --store; exit code 3 where there are any)",
    },
    "template list": {**_STORE, "templates": "for each template what `--format json` shows"},
    "template show": {
        **_STORE,
        "class": "the argument CLASS",
        "kind": "soft or hard",
        "about": "where the template comes from, in words",
        "features": "names of the features",
        "values": "for each column of the template the value of every feature, from 0 to 1",
        "file": "path of the file that was written, or null",
    },
    "template diff": {
        **_STORE,
        "classes": "both arguments CLASS",
        "kind": "soft or hard",
        "delta": "threshold of wildcards",
        "lines": "the contradictions, in words",
        "file": "path of the picture, or null",
    },
    **{
        f"{group} from-clip": {
            **_STORE,
            "name": f"name of the {group}",
            "yaml": "the text of its file",
            "file": "path of the file that was written, or null",
        }
        for group in ("template", "query")
    },
    "keyframes learn": _RUN,
    "keyframes show": {
        **_STORE,
        "stage": "stage that learned them",
        "queries": "for each query what `--format json` has",
    },
    "keyframes export": {
        **_STORE,
        "stage": "stage that learned them",
        "queries": "number of queries",
        "yaml": "the text of the query file",
        "file": "path of the file that was written, or null",
    },
    "mapping new": {
        "motion_file": "the argument FILE",
        "file": "path of the mapping that was written",
        "yaml": "its text",
    },
    "mapping nodes": {
        "file": "the argument FILE",
        "refused": "why the file is refused, or null",
        "nodes": "for each node its name `node`, the joint or landmark `name` that it is taken for, the `reason`, and "
        "the `joints` that are made of it",
        "names": "the joints and landmarks that `kinedex mapping new --name` takes",
    },
    "mapping add": {**_STORE, "kept": "for each mapping its `name` and `file`"},
    "mapping remove": {**_STORE, "removed": "name of the mapping"},
    "version": {
        "versions": "version of kinedex and of its libraries",
        "path": "folder of the package that runs",
        "installed_path": "folder of the installed package, or null",
    },
}
"""Command → key → meaning. A command that fails prints `error` with `type`, `message`, `exit_code` and `remedy`
instead."""
