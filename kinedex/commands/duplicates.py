"""The command `duplicates`, which lists takes that hold the same motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kinedex.commands.app import MAINTAIN, command
from kinedex.commands.options import FormatOption, JsonOption, OutputOption, StorePath
from kinedex.commands.output import print_json, print_message, show_table
from kinedex.commands.store_access import open_for_reading

if TYPE_CHECKING:
    import pyarrow as pa


@command(MAINTAIN)
def duplicates(
    store: StorePath, form: FormatOption = "table", output: OutputOption = None, as_json: JsonOption = False
) -> None:
    """List takes that hold the same file or the same motion.

    Motion is found that was cut, moved, turned, mirrored, or stored at another rate. The rows are kept in the store as
    the view `duplicates`.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.run_id import new_run_id
    from kinedex.pipelines.inspection.duplicates import find_duplicates, save_duplicates

    opened = open_for_reading(store, "newest")
    found = find_duplicates(opened, Terminal())
    takes = len(opened.take_ids)
    opened.close()
    save_duplicates(opened, found, new_run_id())
    if as_json:
        print_json({"store": store, "takes": takes, "duplicates": found})
        return
    plain = form == "table" and output is None
    show_table(found.drop_columns(["take_id", "of_take_id", "start", "stop"]) if plain else found, form, output)
    if plain:
        print_message(_summary(found, takes))


def _summary(found: pa.Table, takes: int) -> str:
    """Return the line below the table: takes by kind."""
    from kinedex.ops.wording import counted

    rows = list(zip(*(found.column(name).to_pylist() for name in ("take", "same", "share")), strict=True))
    files = {take for take, same, _ in rows if same == "file"}
    whole = {take for take, same, share in rows if same == "motion" and share > 0.9} - files
    parts = {take for take, *_ in rows} - files - whole
    return (
        f"of {counted(takes, 'take')}, {len(files):,} come from a copy of a file, {len(whole):,} hold the motion of "
        f"another take, {len(parts):,} have a part in common with one"
    )
