"""Bodies before simulated depth cameras: the shipped ones, and files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.configs import config_names, parse_yaml
from kinedex.catalog.filmed_bodies import KIND, load_filmed_body, parse_filmed_body
from kinedex.ops.errors import ConfigError

SHIPPED = config_names(KIND)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_bodies_cover_the_fitted_one(name: str) -> None:
    filmed = load_filmed_body(name)
    flesh, fitted = filmed.flesh, len(filmed.body.cone_names)
    assert filmed.name == name
    assert np.allclose(flesh.weights.sum(axis=2), 1.0)
    assert (flesh.radii[:fitted] == filmed.body.radii).all()
    assert len(flesh.radii) > fitted
    assert flesh.kinds.max() + 1 == len(flesh.factors)
    assert (flesh.factors[:, 0] <= flesh.factors[:, 1]).all()


def test_left_and_right_share_their_size_and_the_first_body_has_the_waist_of_the_design() -> None:
    filmed = load_filmed_body("first")
    names = filmed.body.cone_names
    left, right = (filmed.flesh.kinds[names.index(f"{side} thigh")] for side in ("left", "right"))
    assert left == right
    belly, back = filmed.flesh.kinds[-2:]
    assert belly == back
    assert filmed.flesh.factors[belly].tolist() == [0.85, 1.20]
    assert filmed.flesh.clothes.waves_m == 0.004


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("body: cones2", "cones20"),
        ("body: cones20\nflesh: {thig: 1.0}", "m.yaml:3: flesh.thig: must be a kind of part (pelvis, "),
        ("body: cones20\nflesh: {thigh: [1.2, 1.0]}", "the least and the greatest"),
        ("body: cones20\nclothes: {folds_m: {tail: 0.1}}", "must be a kind of part"),
        ("body: cones20\ncones: {tail: {from: root, to: {root: 0.5}, radii: [1, 1]}}", "add up to 1, got 0.5"),
        ("body: cones20\ncones: {tail: {from: rot, to: root, radii: [1, 1]}}", "did you mean"),
        ("body: cones20\ncones: {trunk: {from: root, to: neck, radii: [1, 1]}}", "is a cone of cones20 already"),
        ("body: cones20\nerrors: {dropouts: 2}", "less than or equal to 1"),
    ],
)
def test_a_wrong_file_is_refused_with_line_and_key(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_filmed_body(parse_yaml(f"name: mine\n{text}", Path("m.yaml")))
    assert message in str(caught.value)
