"""Read skeleton mappings and vocabularies of names that users wrote, and add them to the shipped ones."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from kinedex.catalog.configs import Located, parse_yaml, read_text
from kinedex.catalog.skeletons.mappings import Mappings, SkeletonMapping, parse_skeleton
from kinedex.catalog.skeletons.recognition.landmarks import landmarks_with
from kinedex.catalog.skeletons.recognition.names import Vocabulary, load_vocabulary, parse_vocabulary
from kinedex.catalog.skeletons.skeleton_fit import Format
from kinedex.ops.errors import ConfigError

ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True)
class OwnFile:
    """A file with a mapping or a vocabulary that a user wrote.

    Attributes
    ----------
    path : Path
        The file, which errors name.
    text : str
        Its content.
    stored : bool
        True if a store holds it; a file of the same name that the user gives overrides it.
    """

    path: Path
    text: str
    stored: bool = False


def own_files(places: Iterable[str | Path]) -> tuple[OwnFile, ...]:
    """Read files with mappings or vocabularies that a user wrote.

    Parameters
    ----------
    places : iterable of path
        YAML files, and folders whose YAML files are all read.

    Raises
    ------
    ConfigError
        There is no such file or folder, or a folder holds no YAML file.
    """
    found: list[Path] = []
    for place in (Path(one).expanduser() for one in places):
        if place.is_dir():
            inside = sorted(path for path in place.iterdir() if path.suffix.lower() in ENDINGS)
            if not inside:
                raise ConfigError(place, "the folder holds no .yaml file; expected skeleton mappings")
            found += inside
        elif place.is_file():
            found.append(place)
        else:
            raise ConfigError(place, "no such file or folder; expected a skeleton mapping, or a folder of them")
    return tuple(OwnFile(path, read_text(path)) for path in dict.fromkeys(found))


def with_own(mappings: Mappings, files: Iterable[OwnFile], joints: tuple[str, ...]) -> Mappings:
    """Add mappings and vocabularies that a user wrote to the mappings of an archive.

    Parameters
    ----------
    mappings : Mappings
        The mappings of an archive, by `load_mappings`.
    files : iterable of OwnFile
        Mappings, which are preferred to all others if their names fit, and vocabularies, whose names are added to the
        shipped ones.
    joints : tuple of str
        The named joints of the feature set.

    Raises
    ------
    ConfigError
        A file is neither, or is invalid, or two of the files have the same name.
    """
    own: dict[Format, tuple[SkeletonMapping, ...]] = {}
    vocabularies: list[Vocabulary] = []
    labels: list[Located] = []
    digests: list[str] = []
    names: dict[str, Path] = {}
    for file in sorted(files, key=lambda one: one.stored):
        found = parse_own(file, joints)
        if found.name in names:
            if file.stored:
                continue
            taken = names[found.name]
            raise ConfigError(file.path, f"{taken} has the name '{found.name}', too; rename one", key="name")
        names[found.name] = file.path
        if not isinstance(found.content, SkeletonMapping):
            vocabularies += [found.content] if isinstance(found.content, Vocabulary) else []
            labels += [found.content] if isinstance(found.content, Located) else []
            digests.append(hashlib.sha256(file.text.encode()).hexdigest()[:16])
        elif found.content.format not in mappings.forced:
            own[found.content.format] = (*own.get(found.content.format, ()), found.content)
    vocabulary = load_vocabulary("joints").merged(vocabularies) if vocabularies else None
    landmarks = landmarks_with(labels) if labels else None
    return replace(mappings, own=own, vocabulary=vocabulary, landmarks=landmarks, vocabulary_digest=" ".join(digests))


@dataclass(frozen=True)
class Own:
    """A mapping or vocabulary that a user wrote, parsed.

    Attributes
    ----------
    name : str
        Its name.
    content : SkeletonMapping, Vocabulary or Located
        Its content; labels of landmarks stay parsed YAML.
    """

    name: str
    content: SkeletonMapping | Vocabulary | Located


def parse_own(file: OwnFile, joints: tuple[str, ...]) -> Own:
    """Parse a mapping or vocabulary that a user wrote.

    Parameters
    ----------
    file : OwnFile
        The file.
    joints : tuple of str
        The named joints of the feature set.

    Raises
    ------
    ConfigError
        The file is neither a mapping nor a vocabulary of names or labels, or it is invalid.
    """
    located = parse_yaml(file.text, file.path)
    keys = located.mapping()
    if "terms" in keys:
        vocabulary = parse_vocabulary(located, tuple(load_vocabulary("joints").terms))
        return Own(str(keys.get("name") or file.path.stem), vocabulary)
    if {"skin", "centres"} & keys.keys():
        landmarks_with([located])
        return Own(str(keys.get("name") or file.path.stem), located)
    if "joints" not in keys:
        raise located.error(
            "expected a skeleton mapping (`joints`), names of nodes (`terms`) or labels of markers (`skin`, `centres`)"
        )
    mapping = parse_skeleton(located, joints)
    return Own(mapping.name, mapping)
