"""The commits that are compared: their checkouts and environments below `build/against`."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import KinedexError

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "against"
DRIVERS = ROOT / "benchmarks" / "drivers"

FIRST = "73a6512"
"""The commit to compare with while there is no tag: the last one before reading lost its speed."""


class UnknownCommitError(KinedexError):
    """Say that a commit cannot be compared with, as the git history lacks it."""


@dataclass(frozen=True)
class Side:
    """One of the two commits: an interpreter, a checkout, a driver, and a folder for its stores.

    Attributes
    ----------
    name : str
        The commit as it was named, or "this" for the working tree.
    python : Path
        The interpreter of its environment.
    tree : Path
        The checkout.
    driver : Path
        The module that does the work at this commit.
    work : Path
        Folder of its stores.
    """

    name: str
    python: Path
    tree: Path
    driver: Path
    work: Path


def this_side() -> Side:
    """Return the working tree with the environment that runs this."""
    return Side("this", Path(sys.executable), ROOT, DRIVERS / "public_api.py", BUILD / "this")


def newest_tag() -> str | None:
    """Return the newest release tag before this commit; None where there is none, or no history."""
    done = _git("describe", "--tags", "--abbrev=0", "--match", "v*", "HEAD^")
    return done.stdout.strip() if done.returncode == 0 else None


def resolve(commit: str) -> str:
    """Return the full hash of a commit or tag.

    Raises
    ------
    UnknownCommitError
        There is no git history, or the commit is not in it.
    """
    done = _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{commit}^{{commit}}")
    if done.returncode:
        raise UnknownCommitError(
            f"commit '{commit}' is not in the git history of {ROOT}. A commit or tag of this repository was expected; "
            "a checkout without history gets it by: git fetch --unshallow --tags"
        )
    return done.stdout.strip()


def other_side(commit: str, report: object = print, with_page: bool = False) -> Side:
    """Return the side of a commit; make its checkout and environment where they are missing.

    Parameters
    ----------
    commit : str
        A commit or tag.
    report : callable, optional
        Is called with a line on what is made.
    with_page : bool, optional
        True if the explorer's page is needed; it is built where the commit has one.

    Raises
    ------
    UnknownCommitError
        The git history lacks the commit.
    KinedexError
        Its packages could not be installed, or its page could not be built.
    """
    assert callable(report)
    sha = resolve(commit)
    home = BUILD / sha[:12]
    tree, environment = home / "tree", home / "environment"
    if not (tree / "requirements.lock").is_file():
        report(f"checking out {commit} into {tree.relative_to(ROOT)}")
        _git("worktree", "prune")
        done = _git("worktree", "add", "--force", "--detach", str(tree), sha)
        if done.returncode:
            raise KinedexError(f"git could not check out '{commit}' into {tree}: {done.stderr.strip()}")
    python = environment / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if not (environment / "run.stamp").is_file():
        report(f"installing the packages of {commit} into {environment.relative_to(ROOT)}")
        _run([sys.executable, "-m", "venv", "--clear", str(environment)])
        locks = [tree / "requirements.lock", tree / "requirements-dev.lock"]  # the second has what the extras need
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes"]
        _run([*pip, *(word for lock in locks if lock.is_file() for word in ("-r", str(lock)))])
        (environment / "run.stamp").touch()
    if with_page and not (home / "page-built").is_file() and _has_page(tree):
        report(f"building the explorer's page of {commit}")
        _run(["make", "-C", str(tree), "page", f"VENV={environment}"])
        (home / "page-built").touch()
    own = [path for path in DRIVERS.glob("commit_*.py") if sha.startswith(path.stem.removeprefix("commit_"))]
    return Side(commit, python, tree, own[0] if own else DRIVERS / "public_api.py", home / "work")


def _has_page(tree: Path) -> bool:
    makefile = tree / "Makefile"
    return makefile.is_file() and any(line.startswith("page:") for line in makefile.read_text("utf-8").splitlines())


GIT_SECONDS, SETUP_SECONDS = 300.0, 1800.0
"""Bounds on git, and on a step of the installation of an environment."""


def _git(*words: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, timeout=GIT_SECONDS)
    except FileNotFoundError:
        return subprocess.CompletedProcess(words, 127, "", "git is not installed")


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=SETUP_SECONDS)
    if done.returncode:
        raise KinedexError(f"'{' '.join(command)}' failed:\n" + "\n".join(done.stderr.strip().splitlines()[-5:]))
