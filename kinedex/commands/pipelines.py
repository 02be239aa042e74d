"""Define the commands that prepare, run and compare pipelines: init, demo, run, plan, ingest, synth, report compare."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import RUN, command, group
from kinedex.commands.options import (
    ExecutorOption,
    ForceOption,
    JsonOption,
    MetadataOption,
    PipelineArgument,
    RateOption,
    RunOptions,
    SetOption,
    StoreOption,
    StorePath,
    WorkersOption,
    assignments_of,
)
from kinedex.commands.output import print_json, print_message, print_path, show_outcome
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import visible

if TYPE_CHECKING:
    from kinedex.pipelines.ingestion.pattern_proposal import Proposal


@command(RUN)
def init(
    source: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of motion files.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Pipeline to write (.yaml); none unless given."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Propose patterns for the names of motion files, as a pipeline.

    The names are divided into tokens; a table shows the values of each, and whether they look like actors, classes,
    numbers or styles. `kinedex run FILE --store STORE` then runs the pipeline as it is.
    """
    from kinedex.pipelines.ingestion.pattern_proposal import matched_count, propose_patterns
    from kinedex.pipelines.ingestion.pipeline_draft import draft_pipeline
    from kinedex.storage.durable_files import whole_file, write_errors
    from kinedex.storage.formats.motion.sources import scan

    if output is not None and output.suffix not in (".yaml", ".yml"):
        raise KinedexError(f"--output {output}: expected a name with the ending .yaml")
    if output is not None and output.exists() and not force:
        raise KinedexError(f"{output}: exists already; give another --output, or --force to write over it")
    found = scan(source)
    if not found.motions:
        raise KinedexError(f"no motion files below {source}; is this the right folder?")
    paths = [motion.path for motion in found.motions]
    proposals = propose_patterns(paths)
    fitting = matched_count(proposals, paths)
    root = Path(found.motions[0].root)
    if as_json:
        patterns = [{"pattern": one.pattern, "paths": len(one.layout.paths)} for one in proposals]
        print_json({"source": source, "patterns": patterns, "paths": len(paths), "matched": fitting, "file": output})
    else:
        _print_tokens(proposals, fitting, len(paths))
    if output is None:
        again = shlex.join(["kinedex", "init", str(source), "-o", "my.yaml"])
        print_message(f"nothing was written; {again} writes a pipeline")
        return
    text = draft_pipeline(proposals, root, len(paths), fitting, shlex.quote(str(output)))
    with write_errors(output), whole_file(output) as path:
        path.write_text(text, encoding="utf-8")
    if not as_json:
        print_path(output)


def _print_tokens(proposals: list[Proposal], fitting: int, count: int) -> None:
    """Print a table of the tokens of each pattern."""
    from kinedex.console.tables import result_table
    from kinedex.console.terminal import make_console
    from kinedex.ops.wording import counted
    from kinedex.pipelines.engine.display import ResultTable
    from kinedex.pipelines.ingestion.pipeline_draft import value_counts

    console = make_console()
    for proposal in proposals:
        console.print(f"{counted(len(proposal.layout.paths), 'path')}: {proposal.pattern}", markup=False)
        table = ResultTable(("token", "column", "looks like", "values", "most frequent"), frozenset(range(5)))
        for number, token in enumerate(proposal.tokens, 1):
            kind = f"{number} (folder)" if token.column.folder else str(number)
            table.add(kind, token.role or "–", token.why, f"{len(token.column.counts):,}", value_counts(token, 6))
        console.print(result_table(table))
    rest = "" if proposals else ": their names have nothing in common"
    console.print(f"{fitting:,} of {counted(count, 'path')} match{rest}", markup=False)


@command(RUN)
def demo(
    store: Annotated[
        Path | None,
        typer.Argument(
            metavar="STORE",
            help="Directory of the store; created where it is missing.",
            show_default="build/demo-store; build/tracking-store with --tracking, and so on",
        ),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Archive of motion files; a synthetic one is made unless given.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            min=1,
            help="Minutes of motion in the synthetic archive.",
            show_default="30; 3 with --tracking, --depth or --inertial",
        ),
    ] = None,
    method: Annotated[str, typer.Option(help="Method of annotation: thesis, best or numeric.")] = "thesis",
    tracking: Annotated[
        bool, typer.Option("--tracking", help="Film takes by simulated cameras, track and stabilise them.")
    ] = False,
    depth: Annotated[
        bool, typer.Option("--depth", help="Film takes by a simulated depth camera, and reconstruct them.")
    ] = False,
    inertial: Annotated[
        bool, typer.Option("--inertial", help="Put simulated inertial sensors on takes, and judge the takes by them.")
    ] = False,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run everything, from motion files to a report.

    The archive is synthetic, and created if it is missing; --data runs the demo on your own archive instead.
    """
    from kinedex.commands.demo import Demo, run_demo, run_depth_demo, run_inertial_demo, run_tracking_demo
    from kinedex.console.terminal import message_console

    others = {"tracking": run_tracking_demo, "depth": run_depth_demo, "inertial": run_inertial_demo}
    chosen = [name for name, on in (("tracking", tracking), ("depth", depth), ("inertial", inertial)) if on]
    if len(chosen) > 1:
        raise typer.BadParameter(f"{' and '.join(f'--{name}' for name in chosen)} are different demos; choose one")
    if chosen and data is not None:
        raise typer.BadParameter(f"--{chosen[0]} uses takes of the synthetic archive; leave out --data")
    store = store or Path(f"build/{chosen[0] if chosen else 'demo'}-store")
    one = Demo(store, minutes or (3.0 if chosen else 30.0), executor, workers, message_console())
    outcome = others[chosen[0]](one) if chosen else run_demo(one, data, method)
    show_outcome(outcome, store, as_json, repeat=True)


@command(RUN)
def run(pipeline: PipelineArgument, store: StoreOption, *, options: RunOptions, as_json: JsonOption = False) -> None:
    """Run the stages of a pipeline that are not up to date.

    A stage runs if its code, its parameters or its inputs have changed since its last run.
    """
    show_outcome(options.run(pipeline, store), store, as_json)


@command(RUN)
def plan(
    pipeline: PipelineArgument,
    store: Annotated[
        Path, typer.Option("--store", metavar="DIR", help="Directory of the store; nothing is written into it.")
    ],
    assign: SetOption = None,
    force: ForceOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show which stages `run` would run, and why."""
    from kinedex.pipelines.engine.config import load_pipeline
    from kinedex.pipelines.engine.plan import make_plan

    loaded = load_pipeline(pipeline, assignments_of(assign))
    steps = make_plan(loaded, store, frozenset(force or ()))
    if as_json:
        stages = [
            {
                "stage": step.stage.name,
                "inputs": sorted(set(step.stage.inputs.values())),
                "runs_because": step.reason,
                "last_finished": step.record and step.record.finished,
                "last_seconds": step.record and step.record.seconds,
            }
            for step in steps
        ]
        print_json({"pipeline": loaded.name, "description": loaded.description, "store": store, "stages": stages})
        return
    from kinedex.console.tables import plain_text, result_table
    from kinedex.console.terminal import make_console
    from kinedex.pipelines.engine.display import ResultTable

    table = ResultTable(("stage", "inputs", "runs because", "last run"), frozenset(range(4)))
    for step in steps:
        last = f"{step.record.finished} ({step.record.seconds:g} s)" if step.record else "never"
        inputs = ", ".join(sorted(set(step.stage.inputs.values()))) or "–"
        nothing = f"– (unchanged: {step.what})" if step.what else "– (nothing to do)"
        table.add(step.stage.name, inputs, step.reason or nothing, last)
    shown = result_table(table)
    shown.title = plain_text(f"{loaded.name}: {loaded.description}")
    make_console().print(shown)


@command(RUN)
def ingest(
    store: StorePath,
    source: Annotated[Path, typer.Argument(help="Folder of motion files.")],
    rate: RateOption = None,
    metadata: MetadataOption = None,
    prune: Annotated[bool, typer.Option("--prune", help="Drop takes whose file is no longer in the source.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first file that cannot be read.")] = False,
    *,
    options: Annotated[RunOptions, "assign executor workers scheduler max_memory accept known_failures wait"],
    as_json: JsonOption = False,
) -> None:
    """Read motion files into a store and index them.

    This is the pipeline `ingest`. Takes are committed batch by batch; after an interruption, the same command continues
    where it stopped.
    """
    fixed = {f"ingest.{name}": "true" for name, wanted in (("prune", prune), ("strict", strict)) if wanted}
    if rate is not None:
        fixed["ingest.override_rate_hz"] = str(rate)
    if metadata:
        fixed["ingest.metadata"] = json.dumps(list(map(str, metadata)))
    show_outcome(options.run("ingest", store, {"source": str(source)}, fixed), store, as_json)


@command(RUN)
def synth(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to create; empty or missing.")],
    minutes: Annotated[float, typer.Option(min=1, help="Minutes of motion in all.")] = 30.0,
    actors: Annotated[int, typer.Option(min=2, help="Number of actors.")] = 5,
    seed: Annotated[int, typer.Option(help="Seed; the same seed makes the same bytes.")] = 2026,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a synthetic archive of ASF/AMC files with ground truth."""
    from kinedex.commands.demo import make_archive
    from kinedex.console.terminal import message_console

    made = make_archive(directory, minutes, actors, seed, workers, message_console())
    if as_json:
        print_json({**asdict(made), "directory": directory})


report = group("report", "Compare evaluations.", RUN)

FORMATS = (".md", ".html", ".json")
EvaluationArgument = Annotated[
    str,
    typer.Argument(help="Store, folder of its reports, or JSON file of them; ::PIPELINE, ::METHOD, or both choose."),
]


@report.callback()
def _group() -> None:
    """Compare evaluations."""


@command(of=report)
def compare(
    a: EvaluationArgument,
    b: EvaluationArgument,
    split: Annotated[str | None, typer.Option(help="Only this split of evaluations of several methods.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write to this file: .md, .html or .json.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the classes and takes that improved or got worse from A to B.

    Two methods of one evaluation: kinedex report compare STORE::thesis STORE::best

    A store with evaluations of several pipelines means the current one (`kinedex use`), unless ::PIPELINE is given.
    """
    from kinedex.console.terminal import Terminal, make_console
    from kinedex.pipelines.engine.page_files import write_page
    from kinedex.pipelines.evaluation.differences import compare_evaluations, comparisons_json, without_repeats
    from kinedex.pipelines.evaluation.written_evaluations import paired_evaluations, read_evaluations
    from kinedex.reports.difference_tables import comparison_tables, markdown
    from kinedex.reports.methods_page import comparison_page
    from kinedex.storage.formats.json_text import json_text

    if output is not None and output.suffix not in FORMATS:
        raise KinedexError(f"--output {output}: must end in {', '.join(FORMATS)}")
    ours, theirs = read_evaluations(a), read_evaluations(b)
    for remark in dict.fromkeys(one.remark for one in (ours, theirs) if one.remark is not None):
        typer.echo(visible(remark), err=True)
    found = paired_evaluations(ours, theirs, split)
    comparisons = without_repeats(
        [compare_evaluations(one, other, _names(a, b, one.name, other.name)) for one, other in found]
    )
    if as_json:
        print_json(comparisons_json(comparisons))
    elif output is None:
        for one in comparisons:
            Terminal(make_console()).show(*comparison_tables(one))
    if output is not None and output.suffix == ".json":
        write_page(json_text(comparisons_json(comparisons)), output)
    elif output is not None:
        write_page(comparison_page(comparisons) if output.suffix == ".html" else markdown(comparisons), output)


def _names(a: str, b: str, one: str, other: str) -> tuple[str, str]:
    """Return the names of two evaluations for tables; if the names are equal, the command's arguments are appended."""
    if one != other:
        return one, other
    return f"{one} ({a})", f"{other} ({b})"
