"""Define the commands about skeleton mappings: mapping new, nodes, add, list, remove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import MAINTAIN, command, group
from kinedex.commands.options import JsonOption, StorePath, WaitOption, writer_of
from kinedex.commands.output import print_json, show_table
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import visible

mapping = group("mapping", "Make skeleton mappings, and keep them in a store.", MAINTAIN)


@command(of=mapping)
def new(
    file: Annotated[Path, typer.Argument(help="Motion file.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="YAML", help="File to write.")],
    person: Annotated[str, typer.Option(help="The person of a file of several.")] = "",
    source: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Source root; the ASF of an AMC file is looked for up to it.")
    ] = None,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NODE=JOINT",
            help="A joint or landmark that a node is, whatever it is called; `none` for neither. May be given several "
            "times; `kinedex mapping nodes FILE` lists nodes and names.",
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(metavar="REGEX", help="Use the mapping only for files whose names this expression is found in."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a skeleton mapping for a motion file, to be edited.

    If a known mapping fits the names of the file, it is written; otherwise a proposal is made from the recognised
    names, even if the file is refused. What is estimated and what was not found stands in it. With --name, the other
    joints are estimated again from the nodes that you name.
    """
    from kinedex.pipelines.inspection.mapping_proposal import propose_mapping

    if output.exists() and not force:
        raise KinedexError(f"{output}: exists already; give another name, or --force to overwrite it")
    text = propose_mapping(file, output.stem, person, source, named=_named(name or ()), only=only)
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as fault:
        raise KinedexError(f"{output}: cannot be written: {fault.strerror}") from None
    if as_json:
        print_json({"motion_file": file, "file": output, "yaml": text})
        return
    print(visible(f"{output}: edit it, and check it by `kinedex inspect {file} --skeleton {output}`"))


def _named(given: Sequence[str]) -> dict[str, str]:
    """Return the names of nodes that --name has given; a node may have a = in its name."""
    found = {}
    for text in given:
        node, sign, joint = text.rpartition("=")
        if not sign or not node or not joint:
            raise typer.BadParameter(f"--name {text}: expected NODE=JOINT, such as LKNE=lkneelat")
        found[node] = joint
    return found


@command(of=mapping)
def nodes(
    file: Annotated[Path, typer.Argument(help="Motion file.")],
    person: Annotated[str, typer.Option(help="The person of a file of several.")] = "",
    source: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Source root; the ASF of an AMC file is looked for up to it.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the nodes of a motion file, what each is taken for, and why.

    Nodes are the markers or the joints of the file; it may be a file that is refused. The names that `kinedex mapping
    new --name` takes are listed as well.
    """
    import pyarrow as pa

    from kinedex.catalog.features import load_feature_set
    from kinedex.catalog.skeletons.mappings import load_mappings
    from kinedex.catalog.skeletons.named_nodes import guessed_fit, node_guesses, node_names
    from kinedex.storage.formats.motion.file_nodes import read_file_nodes

    mappings = load_mappings("auto", load_feature_set().joints)
    found = read_file_nodes(file, mappings, person, source)
    guesses = node_guesses(found.asked, mappings, guessed_fit(found.asked, mappings), {})
    names = node_names(found.asked, mappings)
    if as_json:
        rows = [{"node": one.node, "name": one.name, "reason": one.reason, "joints": one.joints} for one in guesses]
        print_json({"file": file, "refused": found.fault and found.fault.reason, "nodes": rows, "names": names})
        return
    show_table(
        pa.table(
            {
                "node": [one.node for one in guesses],
                "taken for": [one.name or None for one in guesses],
                "reason": [one.reason for one in guesses],
                "joints made of it": [", ".join(one.joints) for one in guesses],
            }
        ),
        paged=True,
    )
    print(visible(f"names: {', '.join(names)}, or none"))


@command(of=mapping)
def add(
    store: StorePath,
    files: Annotated[
        list[Path], typer.Argument(metavar="FILES...", help="Mappings or vocabularies (.yaml), or folders of them.")
    ],
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Keep mappings of your own in a store.

    Every ingest uses them in addition to the shipped mappings, and tries them first. A vocabulary of names is added to
    the shipped one. A mapping or vocabulary replaces an earlier one of the same name.
    """
    from kinedex.catalog.skeletons.mappings import own_files, parse_own
    from kinedex.storage.store.store import open_store

    opened = open_store(store, at="newest")
    found = [(parse_own(file, opened.feature_set.joints), file) for file in own_files(files)]
    with writer_of(opened, wait) as writer:
        for own, file in found:
            writer.put_mapping(own.name, file.text)
        writer.commit()
    if as_json:
        print_json({"store": store, "kept": [{"name": own.name, "file": file.path} for own, file in found]})
        return
    for own, file in found:
        print(visible(f"{own.name}: kept in {store} ({file.path})"))
    print("The next ingest reads the files of their formats again.")


@command(of=mapping, name="list")
def list_mappings(store: StorePath, as_json: JsonOption = False) -> None:
    """List the mappings and vocabularies that a store keeps."""
    from kinedex.catalog.skeletons.mappings import SkeletonMapping, parse_own
    from kinedex.pipelines.ingestion.parameters import stored_files
    from kinedex.storage.store.store import open_store

    opened = open_store(store, at="newest")
    rows: list[dict[str, str]] = []
    for file in stored_files(store, opened.manifest.mappings):
        own = parse_own(file, opened.feature_set.joints)
        kind = f"for {own.content.format} files" if isinstance(own.content, SkeletonMapping) else "names"
        rows.append({"name": own.name, "kind": kind, "text": file.text})
    if as_json:
        print_json({"store": store, "mappings": rows})
        return
    for row in rows:
        print(visible(f"{row['name']}  {row['kind']}"))
    if not rows:
        print(visible(f"{store} keeps no mappings; `kinedex mapping add {store} FILE` adds one"))


@command(of=mapping)
def remove(
    store: StorePath,
    name: Annotated[str, typer.Argument(help="Name of the mapping, as `kinedex mapping list STORE` prints it.")],
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove a mapping from a store.

    Takes that were read with the mapping are unchanged until the next ingest.
    """
    from kinedex.storage.store.store import open_store

    opened = open_store(store, at="newest")
    with writer_of(opened, wait) as writer:
        if name not in writer.manifest.mappings:
            known = writer.manifest.mappings
            raise KinedexError(f"{store}: it keeps no mapping '{name}'{did_you_mean(name, known)}")
        writer.put_mapping(name, None)
        writer.commit()
    if as_json:
        print_json({"store": store, "removed": name})
    else:
        print(visible(f"{name}: removed from {store}"))
