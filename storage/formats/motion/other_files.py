"""Classify files of an archive that are not motion, by their names and extensions."""

from __future__ import annotations

import os

NO_MOTION = "tables or data in which no reader finds motion"
"""The kind of files with an extension of some reader but content that no reader recognises."""

_SYSTEM, _OTHER = "hidden files and files of the system", "files of other kinds"

_ENDINGS = {
    "labels": ".eaf .pfsx .etf .textgrid .srt .vtt",
    "images or films": ".png .jpg .jpeg .gif .bmp .tif .tiff .webp .svg .ico .heic .avi .mp4 .m4v .mov .mkv .mpg .mpeg "
    ".webm .wmv .mts",
    "sound": ".wav .mp3 .ogg .flac .aiff .m4a .mid",
    "texts": ".txt .md .rst .tex .bib .log .pdf .doc .docx .odt .rtf .ppt .pptx .htm .html .url",
    "archives, which are not unpacked": ".zip .tar .tgz .gz .bz2 .xz .zst .7z .rar",
    "tables": ".csv .tsv .xls .xlsx .ods .parquet .db .sqlite",
    "data": ".json .jsonl .yaml .yml .xml .toml .ini .cfg .mat .h5 .hdf5 .npy .npz .pkl .pickle .pt .pth .bin .dat",
    "files of capture software": ".x1d .x2d .x2e .xcp .mcp .mkr .vsk .vst .vpf .enf .system .history .cal .prj "
    ".qca .mvna .mox .ttp .ttproj .motive",
    "models or meshes": ".osim .obj .ply .stl .mtl .vtp .skp .urdf",
    "programs": ".py .ipynb .m .r .c .h .cpp .cs .java .js .ts .sh .bat .exe .dll .so .pyc",
}
_KINDS = {ending: kind for kind, endings in _ENDINGS.items() for ending in endings.split()}
_TEXT_NAMES = ("license", "licence", "copying", "notice", "readme", "authors", "contributors", "changelog", "makefile")
_SYSTEM_NAMES = ("thumbs.db", "desktop.ini")


def is_of_system(name: str) -> bool:
    """Return whether a file was made by the operating system, not the user: macOS writes ._x.bvh beside x.bvh."""
    return name.startswith(("._", "~$")) or name.lower() in _SYSTEM_NAMES


def kind_of(name: str) -> str:
    """Return the kind of a file that is not motion, by its name; "files of other kinds" if it is unknown."""
    ending = os.path.splitext(name)[1].lower()
    if is_of_system(name) or name.startswith("."):
        return _SYSTEM
    return "texts" if name.lower() in _TEXT_NAMES else _KINDS.get(ending, _OTHER)
