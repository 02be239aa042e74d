"""The glossary's terms lead to modules and views, and every reference to the papers names something that is there."""

from __future__ import annotations

import re
import subprocess
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

from kinedex.catalog.sql.views import MACROS, VIEWS

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
TERMS, PLACES, HEADINGS = re.split(r"^## .*$", PAGE, flags=re.MULTILINE)[1:]
CODE = ("ops", "catalog", "storage", "pipelines", "reports", "explorer", "kinedex")
FOLDERS = (*CODE, "configs", "docs", "benchmarks", "studies", "tests")

NUMBER = r"(?:[1-9]|A(?![a-z]))(?:\.\d{1,2})*"
NUMBERS = rf"{NUMBER}(?: ?\(?[ab]\)?)?(?:(?:, | and | to | or |,? and (?:Eq\.|Figure) ){NUMBER})*"
KINDS = {
    "Equations": rf"(?:Eq\.|Equations?) ({NUMBERS})",
    "Figures": rf"(?:Figures?|Fig\.) ({NUMBERS})",
    "Tables": rf"Tables? ({NUMBERS})",
    "Algorithms": r"Algorithms? (\d)(?!\d)",
    "Sections": (
        r"(?:(?:Sections?|Chapters?|Appendix) |(?:[Tt]hesis|[Pp]aper)(?:'s)?,? \(?(?:Chapters? |Sections? )?)"
        rf"({NUMBERS})"
    ),
}
NOTHING_TO_COMPUTE = {"Related Work", "Related work", "Motivation", "Conclusions", "Introduction"}


def spread(text: str) -> set[str]:
    """Return the numbers of "3.1 to 3.3, 5.1"."""
    found = set()
    for part in text.split(", "):
        first, _, last = part.partition(" to ")
        chapter, dot, begin = first.rpartition(".")
        end = int((last or first).rpartition(".")[2])
        found |= {f"{chapter}{dot}{number}" for number in range(int(begin), end + 1)}
    return found


@cache
def headings(source: str) -> dict[str, dict[str, str]]:
    """Return the numbers of each kind that a source has; of sections with their titles."""
    part = re.split(r"^### ", HEADINGS, flags=re.MULTILINE)
    (text,) = (one for one in part if one.startswith(source))
    kinds = {kind: dict.fromkeys(spread(line), "") for kind, line in re.findall(r"^- (\w+): (\d.*)$", text, re.M)}
    lines = re.findall(r"^ *- (?:Chapter |Appendix )?((?:[1-9]|A)(?:\.\d)*):? (\D.*)$", text, re.MULTILINE)
    return {**kinds, "Sections": dict(lines)}


def source_of(text: str, at: int) -> str:
    """Return the paper that a reference at this place belongs to: the one that was named last before it."""
    before = text[max(at - 400, 0) : at + 15].lower()
    named = {name: before.rfind(name.lower()) for name in ("Thesis", "Diploma thesis", "Keyframe paper")}
    if named["Diploma thesis"] >= 0 and named["Thesis"] == named["Diploma thesis"] + len("diploma "):
        return "Diploma thesis"
    return "Keyframe paper" if named["Keyframe paper"] > named["Thesis"] else "Thesis"


def references(text: str) -> list[tuple[int, str, str, str]]:
    """Return line, source, kind and number of every reference in a text."""
    found = []
    for kind, pattern in KINDS.items():
        for match in re.finditer(pattern, text):
            at = match.start()
            if re.search(r"et al\.? \d{4}, $", text[max(at - 30, 0) : at]):
                continue  # another paper
            line, source = text.count("\n", 0, at) + 1, source_of(text, at)
            numbers = re.findall(NUMBER, match[1])
            if numbers == ["A"] and not match[0].startswith("Appendix"):
                continue  # the article
            found += [(line, source, kind, number) for number in numbers]
    return found


@cache
def sections_of(module: str) -> set[str]:
    """Return the sections at which the glossary's terms and places have a module; none where it is in neither."""
    found = set()
    for row in re.findall(r"^\|(.*)\|$", PLACES, re.MULTILINE):
        if f"`{module}`" in row:
            found |= set(re.findall(NUMBER, row.split(" | ")[0]))
    for row in re.findall(r"^\|(.*)\|$", TERMS, re.MULTILINE) if found else ():
        if f"`{module}`" in row:
            found |= {one for _, source, kind, one in references(row.split(" | ")[2]) if kind == "Sections"}
    return found


def wrong(path: Path) -> list[str]:
    """Return what is wrong with the references of a file."""
    text = path.read_text(encoding="utf-8")
    name = path.relative_to(ROOT)
    found = []
    placed = sections_of(str(name))
    for line, source, kind, number in references(text):
        known = headings(source).get(kind, {})
        if number not in known:
            found.append(f"{name}:{line}: {source} has no {kind[:-1].lower()} {number}")
        elif kind == "Sections" and known[number] in NOTHING_TO_COMPUTE and name.parts[0] in CODE:
            found.append(f"{name}:{line}: {source}, {number} is '{known[number]}'")
        elif kind == "Sections" and source == "Thesis" and placed and not any(one.startswith(number) for one in placed):
            found.append(f"{name}:{line}: the glossary has this module at {', '.join(sorted(placed))}, not at {number}")
    return found


def files() -> list[Path]:
    """Return the project's texts that may refer to the papers, but for this test."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "--", *FOLDERS, "README.md", "CONTRIBUTING.md"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip
    if listed.returncode:
        pytest.skip("no git checkout: its files are not listed")
    paths = [ROOT / line for line in listed.stdout.splitlines()]
    return [
        path
        for path in paths
        if path.suffix in (".py", ".md", ".yaml", ".j2") and path.is_file() and path != Path(__file__)
    ]


def test_every_reference_names_something_that_the_papers_have() -> None:
    assert not [fault for path in files() for fault in wrong(path)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("(thesis, 3.5)", {("Thesis", "Sections", "3.5")}),
        ("thesis, Eq. 3.3, 4.5 and 4.6", {("Thesis", "Equations", n) for n in ("3.3", "4.5", "4.6")}),
        ("thesis, 4.4 and Figure 4.2 (a)", {("Thesis", "Sections", "4.4"), ("Thesis", "Figures", "4.2")}),
        ("(diploma thesis, 3.3.1)", {("Diploma thesis", "Sections", "3.3.1")}),
        ("Tables 3.1 to 3.3", {("Thesis", "Tables", "3.1"), ("Thesis", "Tables", "3.3")}),
        ("thesis's Chapter 4", {("Thesis", "Sections", "4")}),
    ],
)
def test_references_are_read(text: str, expected: set[tuple[str, str, str]]) -> None:
    assert {one[1:] for one in references(text)} == expected


def test_modules_and_tables_of_the_glossary_are_there() -> None:
    for module in re.findall(r"`([\w/]+\.py)`", TERMS + PLACES):
        assert (ROOT / module).is_file(), module
    known = {view.name for view in VIEWS} | {macro.name for macro in MACROS}
    for row in re.findall(r"^\|(.*)\|$", TERMS, re.MULTILINE)[2:]:
        cells = [cell.strip() for cell in row.split(" | ")]
        assert len(cells) == 5, row
        for name in re.findall(r"`(\w+)`", re.sub(r"\(.*?\)|'s `run`", "", cells[4])):
            assert name in known, f"{cells[0]}: no view {name}"


def test_the_sections_of_part_one_that_say_what_to_compute_have_a_module() -> None:
    placed = {number for cell in re.findall(r"^\| ([\d., ]+) \|", PLACES, re.MULTILINE) for number in cell.split(", ")}
    assert placed >= {"2.2", "2.3", "3.3", "3.4", "3.5", "3.6.3", "4.1", "4.2", "4.3", "4.4", "5.2", "5.3", "5.4"}


def test_terms_are_there_once() -> None:
    terms = [row.split(" | ")[0] for row in re.findall(r"^\| (.*) \|$", TERMS, re.MULTILINE)[1:]]
    assert len(terms) == len(set(terms))


# ---- the lists themselves --------------------------------------------------------------------------------


def test_the_headings_are_those_of_the_thesis(shared: Path) -> None:
    lines = (shared / "papers" / "doctoral-thesis-2012.txt").read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("Chapter 1"))
    text = "\n".join(lines[first:])
    kept = headings("Thesis")
    found = dict(re.findall(r"^((?:[1-8]|A)\.\d(?:\.\d)?) +([A-Z][^.\n]{3,70})$", text, re.MULTILINE))
    assert {number: title for number, title in kept["Sections"].items() if "." in number} == found
    chapters = dict(re.findall(r"^([1-9]|A)\t([^\t]+)\t\d+$", "\n".join(lines[:first]), re.MULTILINE))
    assert {number: title for number, title in kept["Sections"].items() if "." not in number} == chapters
    assert set(kept["Figures"]) == set(re.findall(r"^Figure ((?:\d|A)\.\d+)\.", text, re.MULTILINE))
    assert set(kept["Tables"]) == set(re.findall(r"^Table (\d\.\d+)\.", text, re.MULTILINE))
    assert set(kept["Algorithms"]) == set(re.findall(r"^Algorithm (\d) ", text, re.MULTILINE))
    numbered = [set(re.findall(rf"\(({chapter}\.\d+)\)", text)) for chapter in (*"345678", "A")]
    for chapter, printed in zip((*"345678", "A"), numbered, strict=True):
        listed = {number for number in kept["Equations"] if number.startswith(f"{chapter}.")}
        assert printed <= listed  # the text has lost some numbers of the appendix
        assert max(listed, key=_place) == max(printed, key=_place)


def _place(number: str) -> int:
    return int(number.split(".")[1])


def test_the_headings_are_those_of_the_keyframe_paper(shared: Path) -> None:
    text = (shared / "papers" / "keyframe-retrieval-2008.txt").read_text(encoding="utf-8")
    found = {number: title.lower() for number, title in re.findall(r"^#+ (\d(?:\.\d)?)\.? (.*)$", text, re.MULTILINE)}
    kept = {number: title.lower() for number, title in headings("Keyframe paper")["Sections"].items()}
    assert kept.items() <= found.items()
    assert set(found) - set(kept) == {"6", "7"}  # acknowledgments and references


def test_the_headings_are_those_of_the_diploma_thesis(shared: Path) -> None:
    text = (shared / "papers" / "diploma-thesis-2007-excerpt-german.txt").read_text(encoding="utf-8")
    found = set(re.findall(r"^ *((?:2|3)\.\d(?:\.\d)?) [A-Z]", text, re.MULTILINE))
    kept = list(headings("Diploma thesis")["Sections"])
    assert set(kept) <= found
    assert all(one < other for one, other in pairwise(kept))
