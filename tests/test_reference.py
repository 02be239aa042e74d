"""docs/reference.md agrees with the code, and names everything that users can name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.generators.reference import PARTS, reference
from kinedex.catalog.configs import KINDS, config_names
from kinedex.commands.app import COMMON_OPTIONS
from kinedex.pipelines.engine.stage import BUILT_IN, load_stage

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "reference.md").read_text(encoding="utf-8")


def test_the_reference_is_up_to_date() -> None:
    assert reference() == PAGE, "python -m docs.generators.reference"


@pytest.mark.parametrize("stage", BUILT_IN)
def test_every_parameter_of_a_stage_says_what_it_is(stage: str) -> None:
    fields = load_stage(stage).parameters.model_fields
    assert f"\n### {stage}\n" in PAGE
    assert not [name for name, field in fields.items() if not field.description]


def test_every_command_has_its_options_and_a_summary() -> None:
    commands = PAGE.split("\n## Commands")[1].split("\n## JSON output")[0].split("\n### ")[1:]
    assert len(commands) >= 25
    for text in commands:
        lines = text.splitlines()
        assert lines[2].endswith((".", "best")) or ":" in lines[2], lines[0]
        assert not re.findall(r"^\| [^|]+ \| [^|]* \|  \|$", text, re.MULTILINE), f"{lines[0]}: an option without help"


def test_no_table_is_empty() -> None:
    assert not re.findall(r"^.*\n\n\|.*\n\| -.*\n(?!\|)", PAGE, re.MULTILINE)


def test_the_options_of_every_command_are_listed_with_their_meaning() -> None:
    listed = PAGE.split("Every command has these options:\n")[1].split("\n### ")[0]
    assert re.findall(r"^\| `(--[\w-]+)`.* \| \w.*\. \|$", listed, re.MULTILINE) == [
        f"--{name.replace('_', '-')}" for name in COMMON_OPTIONS
    ]


def test_every_kind_of_configuration_file_has_its_keys_and_names() -> None:
    assert set(PARTS) == set(KINDS)
    for kind in KINDS:
        for name in config_names(kind):
            assert f"[`{name}`](../configs/{kind}/{name}.yaml)" in PAGE


def test_the_contents_lead_to_every_part() -> None:
    contents, body = PAGE.split("\n## Commands\n")
    titles = re.findall(r"^##+ .*$", body, re.MULTILINE)
    assert len(re.findall(r"\]\(#", contents)) == len(titles) + 1
