"""Read the files that define bodies for simulated depth cameras: a fitted body with flesh, clothes and errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.bodies import load_body
from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.cones import ConeBody
from kinedex.ops.errors import ConfigError, did_you_mean
from kinedex.ops.simulation.depth_rays import REFERENCE_HEIGHT_M, Clothes, Flesh
from kinedex.ops.simulation.depth_sensors import ExtraErrors

KIND = "bodies/filmed"

Number = Annotated[float, Field(allow_inf_nan=False, ge=-10, le=10)]
Positive = Annotated[float, Field(gt=0, le=10)]
NotNegative = Annotated[float, Field(ge=0, le=10)]
Mixture = str | dict[str, Number]
Factor = Positive | tuple[Positive, Positive]

_DEFAULT = "default"
_SUM = 1e-6


class _Beyond(BaseModel):
    model_config = ConfigDict(extra="forbid")
    start: str = Field(alias="from")
    end: str = Field(alias="to")
    m: Number


class _Cone(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: str = ""
    start: Mixture = Field(alias="from")
    end: Mixture = Field(alias="to")
    forward_m: tuple[Number, Number] = (0.0, 0.0)
    beyond: _Beyond | None = None
    radii: tuple[Positive, Positive]


class _Clothes(BaseModel):
    model_config = ConfigDict(extra="forbid")
    waves_m: NotNegative = 0.0
    folds_m: dict[str, NotNegative] = {}
    fold_length_m: Positive = 0.1


class _Errors(BaseModel):
    model_config = ConfigDict(extra="forbid")
    noise: NotNegative = 1.0
    correlation: Annotated[float, Field(ge=0, le=1)] = 0.0
    ripple_m: NotNegative = 0.0
    ripple_length_m: Positive = 1.0
    dropouts: Annotated[float, Field(ge=0, le=1)] = 0.0


class _FilmedFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = Field(min_length=1)
    description: str = ""
    body: str
    flesh: dict[str, Factor] = {}
    cones: dict[str, _Cone] = {}
    clothes: _Clothes = _Clothes()
    errors: _Errors = _Errors()


@dataclass(frozen=True, eq=False)
class FilmedBody:
    """A body that simulated depth cameras film.

    Attributes
    ----------
    name : str
        The name of the body.
    body : ConeBody
        The body that is fitted to depth images. Flesh covers its cones, and the standing height is taken from it.
    flesh : Flesh
        The cones of the surface that the cameras see.
    disturbance : ExtraErrors
        Errors that the clothes add to those of the sensor.
    """

    name: str
    body: ConeBody
    flesh: Flesh
    disturbance: ExtraErrors


def load_filmed_body(name: str | Path = "first") -> FilmedBody:
    """Read the definition of a body that simulated depth cameras film.

    Parameters
    ----------
    name : str or Path, optional
        The name of a shipped file of `configs/bodies/filmed`, or the path of one.

    Raises
    ------
    ConfigError
        There is no such file, or it is invalid; the message names the line.
    """
    return _load(config_path(KIND, name))


@lru_cache(maxsize=8)
def _load(path: Path) -> FilmedBody:
    return parse_filmed_body(load_yaml(path))


def parse_filmed_body(located: Located) -> FilmedBody:
    """Return the body of a parsed file.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    file = located.model(_FilmedFile)
    try:
        body = load_body(file.body)
    except ConfigError as fault:
        raise located.error(str(fault), "body") from None
    twice = next((name for name in file.cones if name in body.cone_names), None)
    if twice is not None:
        raise located.error(f"is a cone of {file.body} already; give another name", "cones", twice)
    of_cones = [_kind(name) for name in body.cone_names]
    of_cones += [cone.kind or _kind(name) for name, cone in file.cones.items()]
    kinds = list(dict.fromkeys(of_cones))
    numbers = np.array([kinds.index(kind) for kind in of_cones], np.int64)
    weights, forward, beyond, beyond_m, radii = _cones(located, file, body)
    length = np.full(len(numbers), file.clothes.fold_length_m)
    clothes = Clothes(file.clothes.waves_m, _folds(located, file, kinds)[numbers], length)
    flesh = Flesh(weights, forward, beyond, beyond_m, radii, numbers, _factors(located, file, kinds), clothes)
    return FilmedBody(file.name, body, flesh, ExtraErrors(**file.errors.model_dump()))


def _kind(name: str) -> str:
    """Return the kind of a part: its name without its side."""
    return name.removeprefix("left ").removeprefix("right ")


def _cones(
    located: Located, file: _FilmedFile, body: ConeBody
) -> tuple[F64, F64, I64, F64, F64]:  # fmt: skip
    """Return the first five arrays of `Flesh` for all cones, from the weights of the joints to the radii."""
    fitted, count = len(body.cone_names), len(body.cone_names) + len(file.cones)
    weights, forward = np.zeros((count, 2, len(JOINTS))), np.zeros((count, 2))
    beyond, beyond_m, radii = np.zeros((count, 2), np.int64), np.zeros(count), np.ones((count, 2))
    cones, ends = np.indices((fitted, 2))
    for share in range(body.joints.shape[2]):
        np.add.at(weights, (cones, ends, body.joints[..., share]), body.shares[..., share])
    radii[:fitted] = body.radii * (REFERENCE_HEIGHT_M / body.height_m)
    for c, (name, cone) in enumerate(file.cones.items(), fitted):
        at = ("cones", name)
        weights[c] = [_weights(located, cone.start, *at, "from"), _weights(located, cone.end, *at, "to")]
        forward[c], radii[c] = cone.forward_m, cone.radii
        if cone.beyond is not None:
            beyond[c] = [_joint(located, one, *at, "beyond") for one in (cone.beyond.start, cone.beyond.end)]
            beyond_m[c] = cone.beyond.m
    return weights, forward, beyond, beyond_m, radii


def _weights(located: Located, mixture: Mixture, *at: str) -> F64:
    shares: Mapping[str, float] = {mixture: 1.0} if isinstance(mixture, str) else mixture
    found = np.zeros(len(JOINTS))
    for name, share in shares.items():
        found[_joint(located, name, *at)] = share
    if abs(found.sum() - 1.0) > _SUM:
        raise located.error(f"must have shares that add up to 1, got {found.sum():g}", *at)
    return found


def _joint(located: Located, name: str, *at: str) -> int:
    if name not in JOINTS:
        raise located.error(f"must be a named joint, got '{name}'{did_you_mean(name, JOINTS)}", *at)
    return JOINTS.index(name)


def _folds(located: Located, file: _FilmedFile, kinds: list[str]) -> F64:
    """Return the height of the folds of clothes in metres on each kind of body part; 0 if the file gives none."""
    _check_kinds(located, file.clothes.folds_m, kinds, "clothes", "folds_m")
    return np.array([file.clothes.folds_m.get(kind, 0.0) for kind in kinds])


def _factors(located: Located, file: _FilmedFile, kinds: list[str]) -> F64:
    """Return the least and the greatest factor (K, 2) on the radii of the cones of each of K kinds of part."""
    _check_kinds(located, file.flesh, [*kinds, _DEFAULT], "flesh")
    found = []
    for kind in kinds:
        factor = file.flesh.get(kind, file.flesh.get(_DEFAULT, 1.0))
        least, greatest = factor if isinstance(factor, tuple) else (factor, factor)
        if least > greatest:
            key = kind if kind in file.flesh else _DEFAULT
            raise located.error(
                f"must be a factor, or the least and the greatest, got {[least, greatest]}", "flesh", key
            )
        found.append((least, greatest))
    return np.array(found)


def _check_kinds(located: Located, given: Mapping[str, object], kinds: list[str], *at: str) -> None:
    unknown = next((kind for kind in given if kind not in kinds), None)
    if unknown is not None:
        raise located.error(f"must be a kind of part ({', '.join(kinds)}){did_you_mean(unknown, kinds)}", *at, unknown)
